// SPDX-License-Identifier: Apache-2.0
// What the controller remembers from one run to the next: small JSON files in the service's state folder, written whole
// and taken from nobody else.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "shared/base/result.h"

namespace stratalux::rig {

// $STATE_DIRECTORY (systemd's), else /var/lib/stratalux.
[[nodiscard]] std::filesystem::path StateFolder();

// Replaces `file`, whole or not at all, by a JSON object with a number `schema`; readable and writable for its owner
// alone. Two programs or threads at once: one after the other; kBusy where another one holds the folder's lock for a
// second.
[[nodiscard]] Status KeepState(const std::filesystem::path& file, const std::string& json);

// Hands `take` what KeepState was given; where it throws what the JSON library throws (`at`, `get`), the file is not
// what we write. kNotFound: there is no such file. kNewerSchema: of another schema. kFailed: another account than this
// one or root owns it, others may write to it, it is no plain file, or it is not what we write. Each message names the
// file.
[[nodiscard]] Status ReadState(const std::filesystem::path& file, int schema,
                               const std::function<void(const std::string& json)>& take);

// The same for a file that the program goes on without. One that was read and cannot be used (kNewerSchema; kIntegrity:
// not what we write) is renamed, to FILE.newer or FILE.damaged, or where that is taken to FILE.damaged-2 and so on, so
// that the next KeepState destroys nothing. One that could not be read, or may be somebody else's (kFailed), stays: who
// is told so keeps nothing in its place. The message says which.
[[nodiscard]] Status TakeState(const std::filesystem::path& file, int schema,
                               const std::function<void(const std::string& json)>& take);

}  // namespace stratalux::rig

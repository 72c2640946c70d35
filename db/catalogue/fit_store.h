// SPDX-License-Identifier: Apache-2.0
// How a fit gets into the store (docs/file-formats.md, "Fits"): its files first, on the disk; then, in one transaction,
// the question whether it may stand there, and its row. A forgetting that begins before that question refuses the fit;
// one that begins behind it finds all its files.
//
// Refused, without a row: where the session is gone or its forgetting has begun (kNotFound, "session X was forgotten
// ..."), where a visitor's consent does not cover fitting or was withdrawn (kUsage), both with the fit's folder
// removed; and where another worker has taken the job (kFailed), whose folder that is now.
#pragma once

#include <filesystem>
#include <string>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// A folder in its place, STORE/sessions/<id>/fits/<fit>, becomes a fit; an equal id is replaced.
Status RegisterFit(const std::filesystem::path& store, FitRow fit, const RegisterOptions& options = {});

// A fit made elsewhere: `fit_folder` (on the store's disk, named as the fit, not among fits/) is held against its
// fit.json, moved into place, and listed. True where it is new here, or
// was listed and had lost its fit.json. Adopting it again changes nothing and leaves
// `fit_folder` as it is; where an adoption was broken off behind the move, it is continued, without `fit_folder` too.
// kIntegrity: no fit.json, of another session or fit, files missing or not what it says, links; nothing is moved then.
[[nodiscard]] Result<bool> AdoptFit(const std::filesystem::path& store, const std::string& session,
                                    const std::filesystem::path& fit_folder, const RegisterOptions& options = {});

// The row of a folder that its own fit.json proves: it is of that fit and session, each file it names is there as it
// was, and a calibration's record can be read. kIntegrity names what is not.
[[nodiscard]] Result<FitRow> ReadProvenFit(const std::filesystem::path& fit_folder, const std::string& session_id);

// Removes an unfinished fit's folder in sessions/<id>/fits, and where the session was forgotten meanwhile the empty
// folders above it, which fitting may have made anew: kNotFound then, saying so.
Status DiscardFit(const std::filesystem::path& store, const std::string& session,
                  const std::filesystem::path& fit_folder);

}  // namespace stratalux::db

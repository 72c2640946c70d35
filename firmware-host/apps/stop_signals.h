// SPDX-License-Identifier: Apache-2.0
// SIGINT and SIGTERM as a flag that the sequencer looks at before each shot.
#pragma once

#include <atomic>

namespace stratalux::rig {

// Installs the handlers (once a process) and returns the flag. A second signal ends the process at once, as the default
// action does; the store's next opening then marks the session failed.
[[nodiscard]] const std::atomic<bool>& InstallStopSignals();

}  // namespace stratalux::rig

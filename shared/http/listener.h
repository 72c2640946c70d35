// SPDX-License-Identifier: Apache-2.0
// The socket that a server listens on.
#pragma once

#include <string>

#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::http {

struct Listener {
  UniqueFd socket;
  int port = 0;
};

// As ServerOptions: kUsage: no address; kBusy: the port is taken; kFailed: not this machine's address.
[[nodiscard]] Result<Listener> Listen(const std::string& address, int port);

}  // namespace stratalux::http

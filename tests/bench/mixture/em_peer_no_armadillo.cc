// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/mixture/em_peers.h"

namespace stratalux::bench {

PeerEm ArmadilloEm() { return nullptr; }

}  // namespace stratalux::bench

// SPDX-License-Identifier: Apache-2.0
// The normal distribution function and its antiderivative by tables: profiles and pixels ask for them by the hundred.
#pragma once

namespace stratalux::fit {

// Share of a normal distribution below x. Error below 1e-10.
[[nodiscard]] double NormalBelow(double x);
// Its antiderivative, 0 at minus infinity. Error below 1e-11.
[[nodiscard]] double NormalRamp(double x);

}  // namespace stratalux::fit

// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/page_text.h"

#include <cmath>

#include "shared/base/formatted.h"

namespace stratalux::fit {

std::string Fixed(double value, int digits) {
  if (!std::isfinite(value)) return "-";
  return Formatted("%.*f", digits, value);
}

std::string Signed(double value, int digits) { return (value >= 0.0 ? "+" : "") + Fixed(value, digits); }

std::string PlusMinus(double value, double sd, int digits) { return Fixed(value, digits) + " ± " + Fixed(sd, digits); }

}  // namespace stratalux::fit

// SPDX-License-Identifier: Apache-2.0
// The figures of a session's report, as metrics.json has them.
#pragma once

#include "fitter/evaluation/metrics.h"
#include "fitter/report/html_report.h"

namespace stratalux::fit {

[[nodiscard]] ReportSection FiguresSection(const Metrics& metrics);

}  // namespace stratalux::fit

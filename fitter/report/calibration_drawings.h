// SPDX-License-Identifier: Apache-2.0
// The drawings of a geometric calibration's page. Poses have one colour each, the same in all of them.
#pragma once

#include <cstddef>
#include <string>

#include "fitter/calibration/calibrate_rig.h"
#include "fitter/report/html_report.h"

namespace stratalux::fit {

// Short name of a pose, for a mark: its number as captured, else its place in the report.
[[nodiscard]] std::string PoseMark(const GeometryReport& report, size_t pose);

// Arrows from where each corner was seen to where the calibration puts it, in the device's picture, magnified; crosses:
// corners left out (camera only).
[[nodiscard]] ReportDrawing DrawResiduals(const GeometryReport& report, size_t device);
// How many corners each cell of the device's picture holds.
[[nodiscard]] ReportDrawing DrawCoverage(const GeometryReport& report, size_t device);
// Where each board's normal points, degrees to the right and down of the camera's axis.
[[nodiscard]] ReportDrawing DrawTilts(const GeometryReport& report);

enum class RigView { kTop, kSide, kOblique };
// Camera, projectors with their fields of view, and all boards, without perspective, to scale.
[[nodiscard]] ReportDrawing DrawRig(const GeometryReport& report, RigView view);

}  // namespace stratalux::fit

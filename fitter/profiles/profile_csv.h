// SPDX-License-Identifier: Apache-2.0
// Measured line-spread profiles as CSV: anyone's goniometric or slit data (docs/profiles.md).
//
// u = observed position minus line position in the tangent plane, mm (the opposite of model section 6).
// incidence_deg > 0: the light travels towards +u, the lamp stands at -u; exit_deg > 0: the light leaves towards +u.
// radiance: 1 = a white target under the irradiance of the slit; mean over the u step.
#pragma once

#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::fit {

// One source: a line of light at one incidence, seen at one exit angle, on a regular grid of u.
struct LineProfile {
  std::string source;
  double incidence_deg = 0.0, exit_deg = 0.0;
  double slit_mm = 0.0;
  double first_u_mm = 0.0, step_mm = 0.0;
  std::vector<double> radiance;  // by rising u; of `samples` where the file has no radiance
  int samples = 0;
};

// A CSV file kept as it is, so that a column can be appended.
struct CsvTable {
  std::string name;  // of the file, for messages
  std::vector<std::string> header;
  std::vector<std::vector<std::string>> rows;
  std::vector<int> line;  // of each row in the file
};

struct ProfileFile {
  CsvTable table;
  std::vector<LineProfile> profiles;           // in order of first appearance
  std::vector<std::pair<int, int>> placement;  // [row] -> (profile, sample)
};

// Reads `path` ("-": standard input). kNotFound: no such file; kUsage with file:line: a missing column, a value that is
// no number or out of range, angles or slit that change within a source, u not regular, too few samples.
[[nodiscard]] Result<ProfileFile> ReadProfiles(const std::string& path, bool with_radiance);

// The table with `radiance` [row] as its last column ("-": standard output); a radiance column it had is replaced.
Status WriteProfiles(const std::string& path, const CsvTable& table, const std::vector<double>& radiance);

}  // namespace stratalux::fit

// SPDX-License-Identifier: Apache-2.0
// Tables of `stratalux-fit profiles fit` and `predict`, and the model file that the second one reads.
#include <vector>

#include "fitter/profiles/profile_csv.h"
#include "fitter/profiles/profile_model.h"
#include "tests/fuzz/target.h"

namespace {

using namespace stratalux;

// Each row has its place in a profile.
void CheckPlacement(const fit::ProfileFile& file) {
  if (file.placement.size() != file.table.rows.size()) fuzz::Fault("a row without a place");
  for (const auto& [profile, sample] : file.placement)
    if (profile < 0 || profile >= static_cast<int>(file.profiles.size()) || sample < 0 ||
        sample >= file.profiles[static_cast<size_t>(profile)].samples)
      fuzz::Fault("a place that is none");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const fuzz::InputFolder folder;
  const auto file = folder.Put("profiles.csv", {data, size});
  const auto asked = fit::ReadProfiles(file, false);
  if (fuzz::Judge(asked)) {
    CheckPlacement(*asked);
    fuzz::Judge(
        fit::WriteProfiles(folder.path() / "out.csv", asked->table, std::vector(asked->table.rows.size(), 0.5)));
  }
  const auto measured = fit::ReadProfiles(file, true);
  if (fuzz::Judge(measured)) CheckPlacement(*measured);
  const auto model = fit::ProfileModel::FromJson(fuzz::TextOf(data, size), "model.json");
  if (!fuzz::Judge(model)) return 0;
  (void)model->ToJson();
  fit::LineProfile profile{"source", 30.0, -30.0, 0.5, -2.0, 0.1, {}, 41};
  if (!model->sources.empty()) profile.source = model->sources.front().source;
  (void)fuzz::Judge(fit::PredictProfile(*model, profile));
  return 0;
}

// SPDX-License-Identifier: Apache-2.0
// The capture plan of a manifest.
#include "shared/capture/plan.h"
#include "tests/fuzz/target.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  const auto options = PlanOptionsFromJson(fuzz::TextOf(data, size));
  if (!fuzz::Judge(options)) return 0;
  const auto plan = BuildPlan(*options);
  if (!fuzz::Judge(plan)) fuzz::Fault("options that were read make no plan");
  const auto again = PlanOptionsFromJson(PlanOptionsToJson(*options));
  if (!again.ok() || PlanOptionsToJson(*again) != PlanOptionsToJson(*options))
    fuzz::Fault("a plan that was written is not read again");
  return 0;
}

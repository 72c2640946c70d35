// SPDX-License-Identifier: Apache-2.0
// plan_of_many FOLDER VISITORS SECONDS: a plan of so many visitors, each of whom took so long, for tests of what is
// done with plans.
#include <cstdio>
#include <cstdlib>
#include <string>

#include "fitter/batch/shard_plan.h"
#include "fitter/mixture/em_kernel.h"
#include "shared/base/version.h"

int main(int argc, char** argv) {
  using namespace stratalux::fit;
  if (argc != 4) return 2;
  ShardPlan plan;
  plan.made = stratalux::WallNow();
  plan.isa = KernelIsa();
  plan.program = stratalux::kVersion;
  for (int i = 1; i <= std::atoi(argv[2]); ++i) {
    const std::string number = std::to_string(i);
    plan.visits.push_back({"s" + number, "f" + number, 1, VisitCost{std::atof(argv[3]), int64_t{1} << 30}});
  }
  const auto written = WritePlan(argv[1], plan);
  if (!written.ok()) std::fprintf(stderr, "%s\n", written.status().message().c_str());
  return written.status().exit_code();
}

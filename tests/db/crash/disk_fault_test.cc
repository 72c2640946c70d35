// SPDX-License-Identifier: Apache-2.0
// A disk that is full, or that cannot sync, from any call on: said with path and reason, and nothing promised is lost.
#include <algorithm>
#include <cstdio>

#include <gmock/gmock.h>

#include "tests/db/crash/crash_fixture.h"
#include "tests/db/crash/disk_model.h"
#include "tests/db/crash/enumeration.h"
#include "tests/db/crash/store_check.h"

namespace stratalux::db::crash {
namespace {

using ::testing::AnyOf;
using ::testing::HasSubstr;

// A refusal costs a night and two or three stores that are read; a power cut costs a store.
int64_t FaultStride() { return SampledStride() == 1 ? 1 : int64_t{4} * SampledStride(); }

struct FaultCounts {
  int64_t faults = 0, said = 0, survived = 0;
  CheckCounts checked;
};

class DiskFaultTest : public CrashTest {
 protected:
  // The same night again and again, each time refusing a later call: each at night, else every FaultStride()-th.
  FaultCounts RefuseEach(DiskFault::Kind kind, DiskFault::Extent extent, const std::vector<std::string>& reasons) {
    FaultCounts counts;
    for (int64_t at = SampledStart(FaultStride()); !HasFailure(); at += FaultStride()) {
      SCOPED_TRACE("call " + std::to_string(at));
      WriteImage({}, Store());
      StartRecording(Store(), {kind, at, extent});
      const WorkloadReport workload = RunWorkload(Store());
      const bool struck = CallsThatFailed() > 0;
      RepairDisk();
      const DiskLog log = StopRecording();
      if (!struck) break;
      ++counts.faults;
      const bool noted = std::ranges::any_of(
          workload.notes, [](const std::string& note) { return note.find("could not be ended") != std::string::npos; });
      (workload.failures.empty() && !noted ? counts.survived : counts.said) += 1;
      ExpectNamed(workload.failures, reasons);
      ExpectKept(log, workload.promises.back(), kind, counts.checked);
    }
    return counts;
  }

  // Each failure names a file or the session, and the disk's reason.
  void ExpectNamed(const std::vector<Status>& failures, const std::vector<std::string>& reasons) const {
    for (const Status& failure : failures) {
      EXPECT_EQ(failure.code(), StatusCode::kFailed) << failure.message();
      EXPECT_THAT(failure.message(), HasSubstr(Store().string()));
      bool named = false;
      for (const std::string& reason : reasons) named |= failure.message().find(reason) != std::string::npos;
      EXPECT_TRUE(named) << failure.message();
    }
  }

  // In memory, and after the power failed at the end: bytes whose sync failed are then gone, whatever was synced later.
  void ExpectKept(const DiskLog& log, const Promise& promise, DiskFault::Kind kind, CheckCounts& counts) const {
    Disk disk(log);
    for (const DiskCall& call : log.calls) disk.Apply(call);
    std::mt19937_64 random(9);
    std::vector<PowerCut> cuts = {PowerCut::kKeepsAll, PowerCut::kDropsAll};
    if (kind == DiskFault::Kind::kSyncError) cuts.push_back(PowerCut::kKeepsSomeBlocks);
    for (const PowerCut cut : cuts) {
      WriteImage(disk.After(cut, random), Remains());
      for (const std::string& broken : CheckStore(Remains(), promise, counts))
        ADD_FAILURE() << "the disk " << ToString(cut) << ": " << broken;
    }
  }

  static void Print(const char* title, const FaultCounts& c) {
    std::printf(
        "%s: %lld calls refused in turn (%lld said, %lld without consequence), %lld stores and %lld frames read\n",
        title, static_cast<long long>(c.faults), static_cast<long long>(c.said), static_cast<long long>(c.survived),
        static_cast<long long>(c.checked.stores), static_cast<long long>(c.checked.frames));
  }
};

const std::vector<std::string> kFull = {"No space left on device", "disk is full",
                                        "check the permissions and the free space"};
const std::vector<std::string> kBroken = {"Input/output error", "disk I/O error"};

TEST_F(DiskFaultTest, AWriteThatFindsNoSpaceOnce) {
  const auto counts = RefuseEach(DiskFault::Kind::kNoSpace, DiskFault::Extent::kOnce, kFull);
  Print("disk full for one call", counts);
  EXPECT_GT((counts.said + 1) * FaultStride(), 100);
}

TEST_F(DiskFaultTest, ADiskThatFillsUpAndStaysFull) {
  const auto counts = RefuseEach(DiskFault::Kind::kNoSpace, DiskFault::Extent::kFromThenOn, kFull);
  Print("disk full from a call on", counts);
  EXPECT_GT((counts.said + 1) * FaultStride(), 100);
}

TEST_F(DiskFaultTest, ASyncThatFailsOnceFailsItsSessionForGood) {
  const auto counts = RefuseEach(DiskFault::Kind::kSyncError, DiskFault::Extent::kOnce, kBroken);
  Print("one failed sync", counts);
  EXPECT_GT((counts.said + 1) * FaultStride(), 30);
}

TEST_F(DiskFaultTest, ADiskThatNeverSyncsAgain) {
  const auto counts = RefuseEach(DiskFault::Kind::kSyncError, DiskFault::Extent::kFromThenOn, kBroken);
  Print("failed syncs from a call on", counts);
  EXPECT_GT((counts.said + 1) * FaultStride(), 30);
}

}  // namespace
}  // namespace stratalux::db::crash

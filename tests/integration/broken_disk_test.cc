// SPDX-License-Identifier: Apache-2.0
// The real programs on a disk that fills up, cannot sync or is gone with the machine, at many moments of a capture.
#include <cstdio>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/mount.h>

#include "tests/integration/tiny_session.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

class BrokenDisk : public TinyStore {
 protected:
  // `fault` as tests/db/crash/preload.cc reads it, without the folder.
  [[nodiscard]] Outcome Capture(const std::string& fault) const {
    const std::string arm = fault.empty()
                                ? ""
                                : std::string("export ASAN_OPTIONS=verify_asan_link_order=0 LD_PRELOAD=") +
                                      STRATALUX_FAULT_LAYER + " STORE_FAULT='" + fault + " " + store_.string() + "';";
    return Run("stratalux-rig capture --simulate --no-scattering --seed 4 --config " + File("rig.toml", kTinyConfig),
               arm);
  }
  [[nodiscard]] Json Newest() const { return Json::parse(Run("stratalux-db ls --json").out)[0]; }

  // Every session but the newest is as it was, the newest one is what the programs may still show of it.
  void ExpectOthersUnharmed() const {
    const Outcome verify = Run("stratalux-db verify");
    EXPECT_EQ(verify.code, 0) << verify.out << verify.err;
    for (const char* id : {"s000001-", "s000002-"}) EXPECT_THAT(verify.out, HasSubstr(id));
  }

  void ExpectCleanFailures(const std::string& kind, const std::vector<int>& calls,
                           const std::vector<std::string>& reasons) {
    int failed = 0;
    for (const int at : calls) {
      SCOPED_TRACE(kind + " " + std::to_string(at));
      const Outcome outcome = Capture(kind + " " + std::to_string(at) + " on");
      EXPECT_EQ(outcome.signal, 0) << outcome.err;
      EXPECT_EQ(outcome.code, 1) << outcome.err;
      const std::string said = outcome.out + outcome.err;
      EXPECT_THAT(said, HasSubstr(store_.string()));
      bool named = false;
      for (const std::string& reason : reasons) named |= said.find(reason) != std::string::npos;
      EXPECT_TRUE(named) << said;
      failed += outcome.code == 1 ? 1 : 0;
      EXPECT_EQ(Capture("").code, 0) << "the disk is well again";
      ExpectOthersUnharmed();
    }
    std::printf("%s: %d captures failed with exit code 1, a reason and no harm to the others\n", kind.c_str(), failed);
  }
};

TEST_F(BrokenDisk, FillsUpDuringACapture) {
  ExpectCleanFailures("nospace", {0, 20, 150, 300, 600}, {"No space left on device", "disk is full", "free space"});
}

TEST_F(BrokenDisk, CannotSyncDuringACapture) {
  ExpectCleanFailures("syncerror", {0, 2, 9, 25, 33}, {"Input/output error", "disk I/O error"});
}

TEST_F(BrokenDisk, ARigKilledAtAnyMomentLosesNothingAcknowledgedAndTheNextProgramSaysWhatItCut) {
  int kills = 0, unfinished = 0;
  int64_t frames = 0;
  for (const int at : {5, 60, 111, 112, 250, 400, 600, 660}) {
    SCOPED_TRACE(at);
    const Outcome killed = Capture("death " + std::to_string(at) + " once");
    EXPECT_EQ(killed.code, -1);
    ++kills;
    // Looking changes nothing and warns of what is left to do.
    const auto before = Contents(store_);
    const Outcome list = Run("stratalux-db ls --json");
    ASSERT_EQ(list.code, 0) << list.err;
    const Json newest = Json::parse(list.out)[0];
    EXPECT_TRUE(Contents(store_) == before);
    const bool recording = newest["status"] == "recording";
    EXPECT_EQ(list.err.find("warning: session " + newest["session"].get<std::string>()) == 0, recording) << list.err;
    // The next capture ends it and says so.
    const Outcome next = Capture("");
    EXPECT_EQ(next.code, 0) << next.err;
    ExpectOthersUnharmed();
    if (!recording) continue;
    ++unfinished;
    const std::string id = newest["session"];
    EXPECT_THAT(next.err, AnyOf(HasSubstr("warning: session " + id + ": ended as failed"),
                                HasSubstr("warning: session " + id + ": ended as its manifest says")));
    const Outcome extract = Run("stratalux-db frames " + id + " --json --extract " + (folder_ / id).string());
    EXPECT_EQ(extract.code, 0) << extract.err;
    EXPECT_EQ(Json::parse(extract.out).size(), newest["frames"].get<size_t>()) << "acknowledged frames stay";
    frames += newest["frames"].get<int64_t>();
  }
  std::printf("%d rigs killed, %d sessions left unfinished and ended by the next program, %lld frames kept\n", kills,
              unfinished, static_cast<long long>(frames));
  EXPECT_GT(unfinished, 3);
}

TEST_F(BrokenDisk, ASecondWriterIsToldThatTheStoreIsBusy) {
  const std::string hold = "flock -n " + (store_ / "write.lock").string() + " true && exec 9<>" +
                           (store_ / "write.lock").string() + " && flock -n 9;";
  const auto before = Contents(store_);
  const Outcome outcome =
      Run("stratalux-rig capture --simulate --no-scattering --config " + File("rig.toml", kTinyConfig), hold);
  EXPECT_EQ(outcome.code, 5) << outcome.err;
  EXPECT_THAT(outcome.err, AllOf(HasSubstr(store_.string()), HasSubstr("being written by another program")));
  EXPECT_TRUE(Contents(store_) == before);
  ExpectUnharmed();
}

TEST_F(BrokenDisk, MountedReadOnlyIsReadByEveryProgramAndWrittenByNone) {
  if (mount(store_.c_str(), store_.c_str(), nullptr, MS_BIND, nullptr) != 0)
    GTEST_SKIP() << "no read-only mount can be made here";
  ASSERT_EQ(mount(nullptr, store_.c_str(), nullptr, MS_BIND | MS_REMOUNT | MS_RDONLY, nullptr), 0);
  ExpectUnharmed();
  for (const char* verb : {"stratalux-db ls", "stratalux-db show latest", "stratalux-db frames s000001"})
    EXPECT_EQ(Run(verb).code, 0) << verb;
  EXPECT_EQ(Run("stratalux-db frames s000001 --phase reference --extract " + (folder_ / "pictures").string()).code, 0);
  const Outcome capture = Capture("");
  EXPECT_EQ(capture.code, 1);
  EXPECT_THAT(capture.err, AllOf(HasSubstr(store_.string()), HasSubstr("Read-only file system")));
  const Outcome fit = Run("stratalux-fit run s000001 --pool 3");
  EXPECT_EQ(fit.code, 1);
  EXPECT_THAT(fit.err, AllOf(HasSubstr(store_.string()), HasSubstr("Read-only file system")));
  umount2(store_.c_str(), MNT_DETACH);
}

}  // namespace
}  // namespace stratalux

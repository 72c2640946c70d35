// SPDX-License-Identifier: Apache-2.0
// Accepted calibrations are versions of their rig, and live as long as the fits that hold them.
#include "db/catalogue/calibration_store.h"

#include <gmock/gmock.h>

#include "db/care/reindex.h"
#include "db/care/verify.h"
#include "db/privacy/forget.h"
#include "shared/capture/rig_calibration.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int64_t kDay_ns = 86'400'000'000'000;
const RigIdentity kBench{"bench", true};

RigCalibration Record(double focal, int64_t made_ns, int64_t valid_until_ns) {
  RigCalibration record;
  record.source = "calibration session";
  record.camera.model = {64, 48, focal, focal, 31.5, 23.5, {}};
  record.projectors.emplace_back();
  record.projectors[0].name = "projector 0";
  record.projectors[0].model = {32, 24, 90, 90, 15.5, 11.5, {}};
  record.projectors[0].white_dn_mm2_per_ms = {1, 1, 1};
  record.made_wall.ns = made_ns;
  record.valid_until_wall.ns = valid_until_ns;
  return record;
}

class CalibrationStoreTest : public StoreTest {
 protected:
  // As `stratalux-fit calibrate` does it.
  void Accept(const std::string& session, const std::string& fit, const RigCalibration& record,
              int64_t created_ns) const {
    SessionStore store = OpenStore();
    const auto folder = store.FitFolder(session, fit);
    std::filesystem::create_directories(folder);
    WriteText(folder / "calibration.json", record.ToJson() + "\n");
    const Status done = store.RegisterFit({fit, session, R"({"stage":"calibrate"})", "{}", {created_ns}, ""});
    ASSERT_TRUE(done.ok()) << done.message();
  }
  std::vector<CalibrationVersion> List() const {
    auto versions = ListCalibrations(folder_, kBench);
    EXPECT_TRUE(versions.ok()) << versions.status().message();
    return versions.ok() ? *versions : std::vector<CalibrationVersion>();
  }
  Logger logger_{LogLevel::kError};
};

TEST_F(CalibrationStoreTest, CountsVersionsInTheOrderOfTheirCaptures) {
  const std::string session = StoreSession(1);
  Accept(session, "f1", Record(100, 5 * kDay_ns, 35 * kDay_ns), 900);
  Accept(session, "f2", Record(101, 9 * kDay_ns, 39 * kDay_ns), 901);
  Accept(session, "f3", Record(102, 2 * kDay_ns, 32 * kDay_ns), 902);  // of older captures, calibrated last
  const auto versions = List();
  ASSERT_EQ(versions.size(), 3U);
  EXPECT_EQ(versions[0].fit, "f2");
  EXPECT_EQ(versions[0].version, 3);
  EXPECT_EQ(versions[0].superseded_by, "");
  EXPECT_EQ(versions[1].fit, "f1");
  EXPECT_EQ(versions[1].superseded_by, versions[0].id);
  EXPECT_EQ(versions[2].fit, "f3");
  EXPECT_EQ(versions[2].version, 1);
  EXPECT_EQ(versions[0].id, CalibrationId(Record(101, 9 * kDay_ns, 39 * kDay_ns).ToJson()));
  EXPECT_TRUE(versions[0].IsValidAt({39 * kDay_ns}));
  EXPECT_FALSE(versions[0].IsValidAt({39 * kDay_ns + 1}));
  EXPECT_DOUBLE_EQ(versions[0].AgeDays({10 * kDay_ns}), 1.0);
}

TEST_F(CalibrationStoreTest, ARecordAcceptedTwiceIsOneVersion) {
  const std::string session = StoreSession(1);
  const RigCalibration record = Record(100, 5 * kDay_ns, 35 * kDay_ns);
  Accept(session, "f1", record, 900);
  Accept(session, "f2", record, 901);
  Accept(session, "f2", record, 902);  // registered again
  ASSERT_EQ(List().size(), 1U);
  EXPECT_EQ(List()[0].fit, "f2");
}

TEST_F(CalibrationStoreTest, IsFoundByLatestOrPrefixOfItsRigAlone) {
  const std::string session = StoreSession(1);
  EXPECT_EQ(FindCalibration(folder_, kBench, "latest").status().code(), StatusCode::kNotFound);
  Accept(session, "f1", Record(100, kDay_ns, 31 * kDay_ns), 900);
  Accept(session, "f2", Record(101, 2 * kDay_ns, 32 * kDay_ns), 901);
  EXPECT_EQ(FindCalibration(folder_, kBench, "latest")->fit, "f2");
  EXPECT_EQ(FindCalibration(folder_, kBench, List()[1].id.substr(0, 12))->fit, "f1");
  EXPECT_EQ(FindCalibration(folder_, kBench, "").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(FindCalibration(folder_, kBench, "xyz").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(FindCalibration(folder_, {"other", true}, "latest").status().code(), StatusCode::kNotFound);
  const auto real = FindCalibration(folder_, {"bench", false}, "latest");
  EXPECT_EQ(real.status().code(), StatusCode::kNotFound) << "a simulation's record is no real rig's";
  EXPECT_THAT(real.status().message(), HasSubstr("--kind calibration"));
}

TEST_F(CalibrationStoreTest, ARecordThatDoesNotSayWhenCountsFromItsSession) {
  const std::string session = StoreSession(1);
  Accept(session, "f1", Record(100, 0, 0), 900);
  const auto rows = *OpenStore().ListSessions();
  ASSERT_EQ(List().size(), 1U);
  EXPECT_EQ(List()[0].made_wall, rows[0].info.finished_wall);
  EXPECT_EQ(List()[0].valid_until_wall.ns - List()[0].made_wall.ns, 30 * kDay_ns);
}

TEST_F(CalibrationStoreTest, SurvivesALostIndex) {
  const std::string first = StoreSession(1), second = StoreSession(2);
  Accept(first, "f1", Record(100, kDay_ns, 31 * kDay_ns), 900);
  Accept(second, "f2", Record(101, 2 * kDay_ns, 32 * kDay_ns), 901);
  Accept(second, "f3", Record(103, 0, 0), 902);
  const auto before = List();
  for (const char* suffix : {"", "-wal", "-shm"})
    std::filesystem::remove(folder_ / ("index.sqlite" + std::string(suffix)));
  const auto report = Reindex(folder_, logger_);
  ASSERT_TRUE(report.ok()) << report.status().message();
  const auto after = List();
  ASSERT_EQ(after.size(), before.size());
  for (size_t i = 0; i < after.size(); ++i) {
    EXPECT_EQ(after[i].id, before[i].id);
    EXPECT_EQ(after[i].version, before[i].version);
    EXPECT_EQ(after[i].made_wall, before[i].made_wall);
    EXPECT_EQ(after[i].valid_until_wall, before[i].valid_until_wall);
    EXPECT_EQ(after[i].superseded_by, before[i].superseded_by);
    EXPECT_EQ(after[i].record_json, before[i].record_json);
  }
}

TEST_F(CalibrationStoreTest, GoesWithTheSessionThatIsForgotten) {
  const std::string first = StoreSession(1), second = StoreSession(1);
  Accept(first, "f1", Record(100, kDay_ns, 31 * kDay_ns), 900);
  Accept(second, "f2", Record(101, 2 * kDay_ns, 32 * kDay_ns), 901);
  ForgetRequest request;
  request.sessions = {second};
  ASSERT_TRUE(Forget(folder_, request, logger_).ok());
  ASSERT_EQ(List().size(), 1U);
  EXPECT_EQ(FindCalibration(folder_, kBench, "latest")->fit, "f1");
}

TEST_F(CalibrationStoreTest, VerifyNamesALostOrChangedRecord) {
  const std::string session = StoreSession(1);
  Accept(session, "f1", Record(100, kDay_ns, 31 * kDay_ns), 900);
  const auto problems = [&] { return VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems; };
  EXPECT_THAT(problems(), IsEmpty());
  const auto file = folder_ / "sessions" / session / "fits" / "f1" / "calibration.json";
  WriteText(file, Record(105, kDay_ns, 31 * kDay_ns).ToJson());
  EXPECT_THAT(problems(), Contains(HasSubstr("not the record that was accepted")));
  WriteText(file, "{");
  EXPECT_THAT(problems(), Contains(HasSubstr(file.string())));
  std::filesystem::remove(file);
  EXPECT_THAT(problems(), Contains(HasSubstr("is gone")));
}

TEST_F(CalibrationStoreTest, ADamagedRecordIsNotAccepted) {
  const std::string session = StoreSession(1);
  SessionStore store = OpenStore();
  std::filesystem::create_directories(store.FitFolder(session, "f1"));
  WriteText(store.FitFolder(session, "f1") / "calibration.json", R"({"schema":1,"id":"c"})");
  EXPECT_EQ(store.RegisterFit({"f1", session, "{}", "{}", {900}, ""}).code(), StatusCode::kIntegrity);
  EXPECT_THAT(List(), IsEmpty());
}

}  // namespace
}  // namespace stratalux::db

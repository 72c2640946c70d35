// SPDX-License-Identifier: Apache-2.0
// Whether a stage still makes the bytes that it made under the same version: artifacts are found by key, and the key
// knows of changed code by the stage's version alone. Bytes depend on compiler, C library and instruction set, so the
// hashes of golden_stages.json stand under these; where yours are not among them the test is skipped.
//   STRATALUX_GOLDEN=write run_kill_test --gtest_filter='StageGolden.*'    writes those of this machine into the
//   sources
#include <algorithm>
#include <cstdlib>
#include <set>

#include <gnu/libc-version.h>
#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

const fs::path kGolden = fs::path(STRATALUX_SOURCE_DIR) / "tests" / "integration" / "golden_stages.json";

// Stage -> version and a hash over the files of all its artifacts; and the instruction set of its kernels.
struct Made {
  Json stages = Json::object();
  std::string isa;
};

Made MadeIn(const fs::path& session) {
  Made made;
  std::map<std::string, std::set<std::string>> files;  // by stage
  for (const auto& entry : fs::directory_iterator(session / "artifacts")) {
    if (!entry.is_directory()) continue;
    const Json record = Json::parse(ReadText(entry.path() / "artifact.json"));
    const std::string stage = record.at("stage");
    made.stages[stage]["version"] = record.at("version");
    if (const std::string isa = record.at("isa"); !isa.empty()) made.isa = isa;
    std::string content = record.at("options").dump();
    for (const Json& file : record.at("files"))
      content += "\n" + file.at("name").get<std::string>() + " " + file.at("xxh3_128").get<std::string>();
    files[stage].insert(content);
  }
  for (const auto& [stage, contents] : files) {
    std::string all;
    for (const std::string& content : contents) all += content + "\n";
    made.stages[stage]["hash"] = db::HashHex(all);
  }
  return made;
}

// Of more pixels than those by which the number of sweeps is chosen: what a sample leaves out is tested, too.
constexpr const char* kSize = "--size 174x130";

class StageGolden : public SmallFit {};

TEST_F(StageGolden, BytesChangeWithTheStagesVersionAlone) {
  const fs::path store = folder_ / "store";
  ASSERT_EQ(Capture(store, kSize).code, 0);
  const Outcome run = Fit(store, std::string("run latest ") + kSmallFitOptions);
  ASSERT_EQ(run.code, 0) << run.out;
  const Made made = MadeIn(Session(store));
  const std::string here = std::string("gcc ") + __VERSION__ + ", glibc " + gnu_get_libc_version() + ", " + made.isa;
  Json golden = Json::parse(ReadText(kGolden));
  if (const char* wanted = std::getenv("STRATALUX_GOLDEN"); wanted != nullptr && std::string(wanted) == "write") {
    golden[here] = made.stages;
    WriteText(kGolden, golden.dump(1) + "\n");
    GTEST_SKIP() << kGolden << " written for " << here;
  }
  if (!golden.contains(here))
    GTEST_SKIP() << kGolden << " has nothing of " << here << "; STRATALUX_GOLDEN=write adds it";
  for (const auto& [stage, now] : made.stages.items()) {
    ASSERT_TRUE(golden[here].contains(stage)) << stage << " is new: STRATALUX_GOLDEN=write";
    const Json& before = golden[here][stage];
    if (before["version"] == now["version"])
      EXPECT_EQ(before["hash"], now["hash"]) << stage << " makes other bytes under version " << now["version"]
                                             << ": raise its version, then STRATALUX_GOLDEN=write";
    else
      ADD_FAILURE() << stage << " is of version " << now["version"] << ", " << kGolden << " knows " << before["version"]
                    << ": STRATALUX_GOLDEN=write";
  }
}

}  // namespace
}  // namespace stratalux

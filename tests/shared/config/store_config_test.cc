// SPDX-License-Identifier: Apache-2.0
#include "shared/config/store_config.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

Result<StoreConfig> Load(const std::string& text) {
  const ScratchFolder scratch;
  const auto file = scratch / "store-config.toml";
  std::ofstream(file) << text;
  return LoadStoreConfig(file);
}

TEST(StoreConfig, TheShippedExamplesControllerTablesAreSkipped) {
  const auto config = LoadStoreConfig(STRATALUX_SOURCE_DIR "/docs/examples/rig.toml");
  ASSERT_TRUE(config.ok()) << config.status().message();
  EXPECT_EQ(config->retention.long_days, RetentionDays{}.long_days);
}

TEST(StoreConfig, AControllersMistakeIsNoneOfTheStores) {
  const auto config = Load("[camera]\nno_such_key = 3\n[retention]\nshort_days = 4\n");
  ASSERT_TRUE(config.ok()) << config.status().message();
  EXPECT_EQ(config->retention.short_days, 4);
}

TEST(StoreConfig, AMistypedTableOrKeyIsNamed) {
  EXPECT_NE(Load("[retentoin]\nshort_days = 4\n").status().message().find(":1: unknown key 'retentoin'"),
            std::string::npos);
  EXPECT_NE(Load("[retention]\nshort_day = 4\n").status().message().find(":2: unknown key 'retention.short_day'"),
            std::string::npos);
  EXPECT_NE(Load("[store]\ncodec = \"zip\"\n").status().message().find(":2: unknown codec 'zip'"), std::string::npos);
}

}  // namespace
}  // namespace stratalux

// SPDX-License-Identifier: Apache-2.0
#include "shared/config/store_config.h"

#include "shared/config/toml_reader.h"

namespace stratalux {

Result<StoreConfig> ReadStoreConfig(TomlTable& root) {
  StoreConfig config;
  TomlTable rig = root.Table("rig"), store = root.Table("store"), retention = root.Table("retention");
  rig.Get("name", config.rig);
  rig.Get("store", config.folder);
  if (store.Has("encrypt")) store.Get("encrypt", config.encrypt.emplace());
  store.Get("sign", config.sign);
  std::string codec = ToString(config.codec);
  store.Get("codec", codec);
  SLX_ASSIGN_OR_RETURN(config.codec, ParseStoreCodec(codec).WithContext(store.Where("codec")));
  retention.Get("short_days", config.retention.short_days, 0, 100000);
  retention.Get("standard_days", config.retention.standard_days, 0, 100000);
  retention.Get("long_days", config.retention.long_days, 0, 100000);
  return config;
}

Result<StoreConfig> LoadStoreConfig(const std::filesystem::path& file) {
  SLX_ASSIGN_OR_RETURN(auto root, TomlTable::ParseFile(file));
  SLX_ASSIGN_OR_RETURN(StoreConfig config, ReadStoreConfig(root));
  // A mistyped [retention] must not pass for a table of the controller, so those are named.
  for (const char* table : {"camera", "capture", "plan", "gpio", "memory", "projector", "kiosk"}) root.Skip(table);
  SLX_RETURN_IF_ERROR(root.Finish());
  return config;
}

}  // namespace stratalux

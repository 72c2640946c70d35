// SPDX-License-Identifier: Apache-2.0
#include "shared/config/rig_config.h"

#include "shared/config/toml_reader.h"

namespace stratalux {
namespace {

Status ReadPlan(TomlTable plan, PlanOptions& o) {
  std::string kind = ToString(o.kind), sync = ToString(o.sync_mode);
  plan.Get("kind", kind);
  plan.Get("sync_mode", sync);
  plan.Get("projectors", o.projectors, 1, 16);
  plan.Get("projector_width", o.projector_width, 16, 8192);
  plan.Get("projector_height", o.projector_height, 16, 8192);
  plan.Get("exposure_ms", o.exposure_ms, 0.01, 10000);
  plan.Get("brackets", o.brackets, 0.001, 1000);
  plan.Get("preroll_markers", o.preroll_markers, 0, 64);
  plan.Get("separation_period", o.separation_period, 3, 8192);
  plan.Get("separation_shifts", o.separation_shifts, 3, 64);
  plan.Get("checkerboard", o.checkerboard);
  plan.Get("checkerboard_period", o.checkerboard_period, 2, 8192);
  plan.Get("checkerboard_shifts", o.checkerboard_shifts, 1, 64);
  plan.Get("comb_width", o.comb_width, 1, 1024);
  plan.Get("comb_period", o.comb_period, 2, 8192);
  plan.Get("comb_step", o.comb_step, 1, 1024);
  plan.Get("row_sweep", o.row_sweep);
  plan.Get("motion_whites", o.motion_whites, 0, 64);
  plan.Get("spot_radius", o.spot_radius, 0, 256);
  plan.Get("spot_pitch", o.spot_pitch, 2, 8192);
  plan.Get("guards", o.guards, 0, 16);
  SLX_ASSIGN_OR_RETURN(o.kind, ParseSessionKind(kind).WithContext(plan.Where("kind")));
  SLX_ASSIGN_OR_RETURN(o.sync_mode, ParseSyncMode(sync).WithContext(plan.Where("sync_mode")));
  return Status::Ok();
}

Result<RigConfig> Read(TomlTable root) {
  RigConfig config;
  TomlTable rig = root.Table("rig"), camera = root.Table("camera"), capture = root.Table("capture"),
            plan = root.Table("plan"), store = root.Table("store"), retention = root.Table("retention");
  rig.Get("name", config.name);
  rig.Get("store", config.store);
  if (store.Has("encrypt")) store.Get("encrypt", config.encrypt.emplace());
  retention.Get("short_days", config.retention.short_days, 0, 100000);
  retention.Get("standard_days", config.retention.standard_days, 0, 100000);
  retention.Get("long_days", config.retention.long_days, 0, 100000);
  camera.Get("width", config.camera_width, 16, 16384);
  camera.Get("height", config.camera_height, 16, 16384);
  capture.Get("settle_ms", config.settle_ms, 0, kLongestSettleMs);
  capture.Get("deadline_ms", config.deadline_ms, 1, 600000);
  capture.Get("max_on_time_s", config.max_on_time_s, 0.1, 3600);
  capture.Get("max_retries", config.max_retries, 0, 10);
  capture.Get("queue_frames", config.queue_frames, 1, 4096);
  std::string codec = ToString(config.codec);
  store.Get("codec", codec);
  SLX_ASSIGN_OR_RETURN(config.codec, ParseStoreCodec(codec).WithContext(store.Where("codec")));
  SLX_RETURN_IF_ERROR(ReadPlan(plan, config.plan));
  SLX_RETURN_IF_ERROR(root.Finish());
  SLX_RETURN_IF_ERROR(BuildPlan(config.plan).status().WithContext(plan.Where()));
  return config;
}

}  // namespace

Result<RigConfig> LoadRigConfig(const std::filesystem::path& file) {
  SLX_ASSIGN_OR_RETURN(auto root, TomlTable::ParseFile(file));
  return Read(std::move(root));
}

Result<RigConfig> ParseRigConfig(const std::string& text, const std::string& name) {
  SLX_ASSIGN_OR_RETURN(auto root, TomlTable::ParseText(text, name));
  return Read(std::move(root));
}

}  // namespace stratalux

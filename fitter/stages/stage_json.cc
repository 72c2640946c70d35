// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/stage_json.h"

#include <cerrno>
#include <cstring>
#include <fstream>

#include "shared/base/json_nesting.h"
#include "shared/base/read_file.h"

namespace stratalux::fit {

Status WriteText(const std::filesystem::path& file, const std::string& text) {
  std::ofstream out(file, std::ios::trunc);
  out << text;
  out.flush();
  return out ? Status::Ok() : Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
}

Status WriteJson(const std::filesystem::path& file, const nlohmann::ordered_json& json) {
  return WriteText(file, json.dump(1) + "\n");
}

Status ReadJson(const std::filesystem::path& file, const std::function<void(const nlohmann::json&)>& read) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  try {
    read(nlohmann::json::parse(text));
    return Status::Ok();
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

}  // namespace stratalux::fit

// SPDX-License-Identifier: Apache-2.0
// Small JSON files of artifacts.
#pragma once

#include <filesystem>
#include <functional>

#include <nlohmann/json.hpp>

#include "shared/base/result.h"

namespace stratalux::fit {

Status WriteJson(const std::filesystem::path& file, const nlohmann::ordered_json& json);
// `read` takes what it needs from the file's JSON and may throw what nlohmann throws: kIntegrity then.
Status ReadJson(const std::filesystem::path& file, const std::function<void(const nlohmann::json&)>& read);

Status WriteText(const std::filesystem::path& file, const std::string& text);

}  // namespace stratalux::fit

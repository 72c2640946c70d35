// SPDX-License-Identifier: Apache-2.0
// Pages as text. Everything that comes from a store passes through Escape().
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "db/catalogue/result_table.h"
#include "shared/base/result.h"
#include "shared/http/message.h"

namespace stratalux::db {

// For text and for attributes in double quotes; what would steer or hide is written out (display_text.h).
[[nodiscard]] std::string Escape(std::string_view text);
// <a href="place">text</a>; `place` is a path of ours.
[[nodiscard]] std::string Link(const std::string& place, std::string_view text);
[[nodiscard]] std::string SessionPlace(std::string_view id);

// A table for people with a caption; ids of sessions in a column `session` are links. Wide ones scroll by themselves.
[[nodiscard]] std::string HtmlTable(const ResultTable& table, const std::string& caption);
// The frame of a table whose rows are markup.
[[nodiscard]] std::string TableFrame(const std::string& caption, const std::vector<std::string>& headers,
                                     const std::string& rows);
// <dl>; values are markup, rows without one are left out.
[[nodiscard]] std::string Facts(const std::vector<std::pair<std::string, std::string>>& facts);
// A word with a mark of its own: complete, degraded, failed, recording.
[[nodiscard]] std::string StatusWord(std::string_view status);

// The whole page: head, navigation with `section` marked ("Sessions"), main part below its heading.
[[nodiscard]] http::Response Page(const std::string& section, const std::string& title, const std::string& main,
                                  int status = 200);
// A page that says why there is no other, by the status' code.
[[nodiscard]] http::Response Problem(const Status& status);

}  // namespace stratalux::db

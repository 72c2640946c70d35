// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/schema_check.h"

#include <string>
#include <system_error>

#include "db/base/sqlite.h"
#include "db/catalogue/session_store.h"

namespace stratalux::db {

Status RequireCurrentSchema(const std::filesystem::path& store) {
  const auto file = store / "index.sqlite";
  std::error_code error;
  // What is not there, foreign, damaged or of a newer program is said by whoever opens it; none of these is migrated.
  if (!std::filesystem::is_regular_file(file, error)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(file, Connection::Mode::kReadOnly));
  const auto version = connection.QueryInteger("PRAGMA user_version");
  if (!version.ok() || *version >= kSchemaVersion) return Status::Ok();
  return Status::Failed(file.string() + " has schema " + std::to_string(*version) + ", this program's is " +
                        std::to_string(kSchemaVersion) + "; migrate it first: `stratalux-db ls --store " +
                        store.string() + "` (a copy of the index is kept beside it)");
}

Status NewerIndex(const std::filesystem::path& store, int64_t version) {
  std::string text = (store / "index.sqlite").string() + ": schema " + std::to_string(version) +
                     " is newer than this program's " + std::to_string(kSchemaVersion) + "; use a newer stratalux";
  // A migration over several schemas leaves one copy, by the name of the last.
  for (int64_t after = version; after > kSchemaVersion; --after) {
    const auto copy = store / ("index-before-" + std::to_string(after) + ".sqlite");
    std::error_code error;
    if (!std::filesystem::is_regular_file(copy, error)) continue;
    auto connection = Connection::Open(copy, Connection::Mode::kReadOnly);
    if (!connection.ok()) continue;
    const auto schema = connection->QueryInteger("PRAGMA user_version");
    if (!schema.ok() || *schema > kSchemaVersion) continue;
    text += ", or go back to " + copy.string() + ", the index as it was before, of schema " + std::to_string(*schema) +
            " (docs/install.md, Going back)";
    break;
  }
  return {StatusCode::kNewerSchema, text};
}

}  // namespace stratalux::db

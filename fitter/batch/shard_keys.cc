// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/shard_keys.h"

#include <algorithm>

#include "db/catalogue/session_store.h"
#include "db/keys/rig_key.h"
#include "db/keys/sealed_key.h"
#include "db/keys/session_key.h"
#include "fitter/batch/night_choice.h"
#include "fitter/batch/shard_manifest.h"

namespace stratalux::fit {

Result<ShardKeys> KeysOf(const std::filesystem::path& store_folder, const ShardPlan& plan, const Shard& shard) {
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(store_folder, db::AccessMode::kReadOnly));
  ShardKeys found;
  for (const size_t place : VisitsOf(plan, shard)) {
    const std::string& session = plan.visits[place].session;
    const auto row = store.FindSession(session);
    if (!row.ok()) {
      found.missing.push_back(row.status().message());
      continue;
    }
    db::KeyId id{};
    if (!db::FromHex(row->key_id, id).ok()) continue;  // not encrypted
    if (const Status may = MayStillBeFitted(store_folder.string(), session, row->info.visitor); !may.ok()) {
      found.missing.push_back(session + ": " + may.message());
      continue;
    }
    auto key = db::FindKeyOf(store_folder, session, id);
    if (!key.ok()) {
      found.missing.push_back(key.status().message());
      continue;
    }
    found.keys.push_back(*key);
    found.sessions.push_back(session);
  }
  return found;
}

bool KeysAreMissing(const std::filesystem::path& store_folder, const std::filesystem::path& results,
                    const ShardPlan& plan, const Shard& shard) {
  const auto manifest = ReadManifest(ManifestFile(results, shard), plan);
  const std::vector<size_t> places = VisitsOf(plan, shard);
  return std::any_of(places.begin(), places.end(), [&](size_t place) {
    const std::string& session = plan.visits[place].session;
    const ShardVisit* ended = manifest.ok() ? manifest->Find(session) : nullptr;
    if (ended != nullptr && (ended->end.kind == NightEventKind::kDone || ended->end.kind == NightEventKind::kDropped))
      return false;
    for (const auto& file : db::ListSealedKeys(store_folder / "sessions" / session))
      if (const auto header = db::ReadSealedKeyHeader(file); header.ok())
        return !db::FindKeyOf(store_folder, session, header->key).ok();
    return false;
  });
}

}  // namespace stratalux::fit

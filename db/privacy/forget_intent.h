// SPDX-License-Identifier: Apache-2.0
// STORE/ledger/<id>.forgetting: what a broken-off `forget` must still remove and look for. Wiped at the end.
// Internal to db/privacy.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "db/catalogue/session_index.h"
#include "db/keys/key_store.h"
#include "db/privacy/forget.h"

namespace stratalux::db {

struct ForgetIntent {
  std::string session, visitor, reason;
  std::string key_id;  // hexadecimal; empty: not encrypted
  WallNs began;
  int64_t frames = 0, fits = 0, files = 0, bytes = 0;
  std::vector<uint64_t> hashes;      // first 8 bytes of each payload hash, as they lie in memory
  std::vector<std::string> exports;  // places, export_marker.h
};

// What a report says of it before anything is gone.
[[nodiscard]] ForgottenSession SessionOf(const ForgetIntent& intent);

// Of ForgetIntent::hashes. Precondition: at least 8 bytes.
[[nodiscard]] uint64_t WordOf(std::span<const uint8_t> bytes);
[[nodiscard]] std::array<uint8_t, sizeof(uint64_t)> BytesOf(uint64_t hash);
// The 16 bytes of a key id, or of the first part of a hash, from hexadecimal text; kIntegrity for other text.
[[nodiscard]] Result<std::vector<uint8_t>> FromHex(const std::string& text);

// A plan needs no hashes.
enum class IntentHashes { kCollected, kLeftOut };

// From index and files; other sessions may share hashes (ScanPlan). Of a forgotten session that lies here again, from
// its files. kNotFound names the first unknown id.
[[nodiscard]] Result<std::vector<ForgetIntent>> CollectIntents(SessionIndex& index, const std::filesystem::path& store,
                                                               const std::vector<std::string>& ids,
                                                               IntentHashes hashes);

// The places of exports that the access log names, of every session: what CollectIntents finds of one.
Status VisitExports(Connection& connection,
                    const std::function<void(const std::string& session, const std::string& place)>& visit);

[[nodiscard]] std::filesystem::path IntentFile(const std::filesystem::path& store, const std::string& session_id);
Status WriteIntent(const std::filesystem::path& store, const ForgetIntent& intent);
// Renamed first: a half-wiped intent must not be taken for one. kOk where another forget has wiped it.
Status WipeIntent(const std::filesystem::path& store, const std::string& session_id);
// Wipes what a program that was killed in the midst of a write or a wipe left of intents. Under the write lock.
Status TidyIntents(const std::filesystem::path& store);
// `unread`: of each that is there and cannot be read, or is damaged, why, and what to do.
[[nodiscard]] Result<std::vector<ForgetIntent>> ReadIntents(const std::filesystem::path& store,
                                                            std::vector<std::string>& unread);

}  // namespace stratalux::db

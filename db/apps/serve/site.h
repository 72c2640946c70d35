// SPDX-License-Identifier: Apache-2.0
// The store as pages of a browser. Nothing is kept open between two requests, so that a page that is being looked at
// neither holds up a `forget` nor shows what is gone.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "db/catalogue/read_only_index.h"
#include "db/catalogue/session_store.h"
#include "db/privacy/disclosure.h"
#include "shared/base/log.h"
#include "shared/http/router.h"

namespace stratalux::db {

// What a session is, as far as its pages need it.
struct ServedSession {
  SessionInfo info;  // without plan and calibration
  int64_t number = 0, frames = 0, bytes = 0;
  std::string key_id;       // 32 hex digits; empty: not encrypted
  std::string calibration;  // id
  // Why its pictures and reports are not shown: a withdrawn consent, or none that covers `fit`. Empty: they are.
  std::string withheld;
};

// Thread-safe.
class Site {
 public:
  Site(const std::filesystem::path& store, Logger& logger) : store_(store), logger_(logger), log_(store, "serve") {}

  [[nodiscard]] const std::filesystem::path& store() const { return store_; }
  // Never migrates: kFailed for a store of an older schema.
  [[nodiscard]] Result<ReadOnlyIndex> OpenIndex() const;
  // By its whole id. kNotFound, also for a session whose forgetting has begun.
  [[nodiscard]] Result<ServedSession> Find(ReadOnlyIndex& index, const std::string& id);
  // What every handler that gives out pixels, or what was made of them, calls first: kNotFound, kUsage where the
  // session is withheld; and the entry in the access log, once a run of the program for each session and `what`
  // ("pictures", "fit f1").
  [[nodiscard]] Result<ServedSession> Disclose(const std::string& id, const std::string& what, const std::string& peer);
  [[nodiscard]] Logger& logger() { return logger_; }

 private:
  std::filesystem::path store_;
  Logger& logger_;
  DisclosureLog log_;
};

// All routes. The site must outlive them.
[[nodiscard]] http::Router RoutesOf(Site& site);

void AddStorePages(Site& site, http::Router& router);    // overview, consent, deletions
void AddSessionPages(Site& site, http::Router& router);  // list, one session
void AddFramePages(Site& site, http::Router& router);    // frames and their pictures
void AddFitPages(Site& site, http::Router& router);      // figures, files, reports
void AddQueryPages(Site& site, http::Router& router);

// Cells of a row, for pages that put them into words; zero or "" where they are of another type.
[[nodiscard]] int64_t IntegerOf(const Cell& cell);
[[nodiscard]] double RealOf(const Cell& cell);
[[nodiscard]] std::string TextOf(const Cell& cell);

}  // namespace stratalux::db

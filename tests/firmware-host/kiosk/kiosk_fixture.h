// SPDX-License-Identifier: Apache-2.0
// A kiosk with scripted visitors, and what must hold of its store.
#pragma once

#include <algorithm>
#include <memory>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "db/catalogue/consent.h"
#include "db/privacy/ticket.h"
#include "firmware-host/kiosk/kiosk.h"
#include "tests/firmware-host/kiosk/scripted_front.h"
#include "tests/firmware-host/kiosk/small_kiosk.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {

class KioskTest : public ScratchFolderTest {
 protected:
  KioskTest() : options_(SmallKiosk(folder_)) {}
  void Open() {
    auto station = CaptureStation::Open(options_.station, stop_, logger_);
    if (!station.ok()) throw std::runtime_error(station.status().message());  // no test goes on without
    station_ = std::move(*station);
  }
  KioskReport Run(int visits, const std::function<Manner(int)>& next) {
    if (!station_) Open();
    front_ = std::make_unique<ScriptedFront>(*station_->rig().simulation, visits, next);
    front_->on_show = on_show_;
    front_->on_preview = on_preview_;
    front_->has_paper = has_paper_;
    auto report = RunKiosk(*station_, options_, *front_, stop_, logger_);
    EXPECT_TRUE(report.ok()) << report.status().message();
    EXPECT_TRUE(Dark());
    return report.ok() ? *report : KioskReport();
  }
  KioskReport Run(const std::vector<Manner>& manners) {
    return Run(static_cast<int>(manners.size()), [&](int visit) { return manners[static_cast<size_t>(visit)]; });
  }
  [[nodiscard]] bool Dark() const {
    const auto switches = station_->rig().simulation->switches();
    return std::none_of(switches.begin(), switches.end(), [](LightSwitch* light) {
      bool on = true;
      return light->Read(on) != 0 || on;
    });
  }
  [[nodiscard]] std::vector<db::SessionSummary> Sessions() const {
    const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
    EXPECT_TRUE(store.ok()) << store.status().message();
    return store.ok() ? *store->ListSessions() : std::vector<db::SessionSummary>();
  }
  // What is left is of visitors who have their ticket, and good for something; nothing else is of anybody.
  void CheckStore() const {
    std::set<std::string> kept, consenting, found, usable;
    for (const ScriptedVisit& visit : front_->visits)
      if (!visit.ticket.empty() && !visit.gave_back) kept.insert(*db::VisitorOfTicket(visit.ticket));
    for (const db::SessionSummary& session : Sessions()) {
      EXPECT_NE(session.info.status, SessionStatus::kRecording) << session.info.id;
      EXPECT_TRUE(session.info.status == SessionStatus::kComplete || !session.info.reasons.empty()) << session.info.id;
      EXPECT_GE(session.info.attempt, 1);
      EXPECT_LE(session.info.attempt, 3);
      EXPECT_NE(session.info.visit, "");
      const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
      if (session.info.status == SessionStatus::kDegraded) {
        EXPECT_FALSE(store->FindSession(session.info.id)->info.found.findings.empty()) << "a named finding";
      }
      EXPECT_NE(session.key_id, "") << "a kiosk's frames are encrypted";
      found.insert(session.info.visitor);
      if (session.info.status != SessionStatus::kFailed) usable.insert(session.info.visitor);
    }
    const auto consents = db::ListConsents(folder_ / "store", "");
    ASSERT_TRUE(consents.ok());
    for (const db::ConsentRow& row : *consents) consenting.insert(row.visitor);
    EXPECT_EQ(found, kept);
    EXPECT_EQ(usable, kept);
    EXPECT_EQ(consenting, kept);
  }

  KioskOptions options_;
  StopToken stop_;
  Logger logger_{LogLevel::kError};
  std::unique_ptr<CaptureStation> station_;
  std::unique_ptr<ScriptedFront> front_;
  std::function<void(const action::Show&)> on_show_;
  std::function<void()> on_preview_;
  bool has_paper_ = true;
};

}  // namespace stratalux::rig

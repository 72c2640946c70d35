// SPDX-License-Identifier: Apache-2.0
// PageFront: the kiosk's page (kiosk_page.h) as what its loop shows screens on and hears presses from.
#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "firmware-host/kiosk/kiosk_front.h"
#include "firmware-host/kiosk/kiosk_page.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

class PageFront final : public KioskFront {
 public:
  // Fails as KioskPage::Start; kFailed where the system gives no descriptor.
  static Result<std::unique_ptr<PageFront>> Start(const KioskPageOptions& options, Logger& logger);

  // Also once a second, so that the page knows that the loop turns.
  [[nodiscard]] int fd() const override { return either_.get(); }
  std::vector<VisitEvent> Take() override;
  void Show(const action::Show& screen) override { page_->Show(screen); }
  bool GiveTicket(const std::string& code) override {
    page_->ShowTicket(code);
    return false;  // a screen has yet to fetch it
  }
  bool TicketTaken() override { return page_->TicketFetched(); }
  void TellOperator(Word word) override { page_->Tell(word); }
  void Preview(const FrameRecord& record, const Image<uint16_t>& pixels) override {
    page_->ShowPreview(record, pixels);
  }
  void ShowSelfchecks(const SelfcheckTrend& trend) override { page_->ShowSelfchecks(trend); }
  void ServeWithdrawals(Withdrawal withdraw) override;

  [[nodiscard]] KioskPage& page() const { return *page_; }

 private:
  PageFront() = default;
  Status Open();
  void Press(const VisitEvent& event);
  Status Withdraw(const std::string& ticket);

  UniqueFd pressed_, second_, either_;
  std::mutex mutex_;
  std::vector<VisitEvent> waiting_;
  std::mutex withdraw_mutex_;  // held while one runs
  Withdrawal withdraw_;
  std::unique_ptr<KioskPage> page_;  // first to go: its threads press
};

}  // namespace stratalux::rig

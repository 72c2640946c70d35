// SPDX-License-Identifier: Apache-2.0
// RigWorker: the one thread that works rig and store for the kiosk, a job at a time, and answers with events. Its first
// job is its own: it forgets the visits that a killed program left without a ticket.
#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "firmware-host/kiosk/face_look.h"
#include "firmware-host/kiosk/forget_search.h"
#include "firmware-host/kiosk/selfcheck_book.h"
#include "firmware-host/kiosk/visit_actions.h"
#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/kiosk/visit_forgetting.h"
#include "firmware-host/session/capture_station.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

struct WorkerOptions {
  StationOptions station;
  VisitTiming timing;
  std::chrono::nanoseconds look_pause = std::chrono::milliseconds(200);  // between two pre-scans
  // Frames of the preview, on the worker's thread.
  std::function<void(const Shot&)> preview;
  // What a self-check measured, `at` yet to be given; true: a figure is not where it usually is. On the worker's
  // thread. May be empty.
  std::function<bool(Selfcheck)> checked = {};
  // Of forgettings: the first half on the worker's thread, the second on that of the search. May be empty.
  std::function<void(db::ForgetStep)> after_forget_step = {};
};

// What the worker is at: a job, of pre-scans one look.
struct WorkInHand {
  Deadline deadline = Deadline::kNone;  // by whose seconds it is to be over
  std::chrono::steady_clock::time_point since;
};

// Whom a visit's sessions belong to: drawn by chance, kept nowhere else.
struct VisitNames {
  uint32_t visit = 0;
  std::string ticket;   // 7K3QZ-M0P4T-3
  std::string visitor;  // the pseudonym, by which the ticket finds it
  std::string name;     // of the visit
};

class RigWorker {
 public:
  // `station` is the worker's from here on; it, `stop` and `logger` outlive it.
  RigWorker(CaptureStation& station, WorkerOptions options, StopToken& stop, Logger& logger);
  // Ends what runs.
  ~RigWorker();
  RigWorker(const RigWorker&) = delete;
  RigWorker& operator=(const RigWorker&) = delete;

  // One of action::Preview, CheckRig, Recover, StartCapture, PrintTicket (which has happened), Discard. Behind what
  // still runs.
  void Begin(const VisitAction& job);
  // Never waits: the guard takes the light, what makes it ends, and a preview tells nothing any more.
  void LightOff();
  // Whether nobody is served (forget_search.h).
  void SetRest(bool rest) { search_.SetRest(rest); }
  // From any thread, as VisitForgetting::Withdraw.
  Status Withdraw(const std::string& visitor) { return forgetting_.Withdraw(visitor); }
  // Readable when there is something to take.
  [[nodiscard]] int fd() const { return wake_.get(); }
  std::vector<VisitEvent> Take();
  // nullopt: nothing, or what a killed program left, which a new start would find again.
  [[nodiscard]] std::optional<WorkInHand> in_hand() const;
  // Of the visit whose capture was begun last.
  [[nodiscard]] VisitNames names() const;

 private:
  void Work();
  void Do(const action::Preview& job);
  void Do(const action::CheckRig& job);
  void Do(const action::Recover& job);
  void Do(const action::StartCapture& job);
  void Do(const action::PrintTicket& job);
  void Do(const action::Discard& job);
  void ForgetWhatWasLeft();
  template <typename T>
  void Do(const T& /*not a job*/) {}
  // One pre-scan; nullopt: ended, or not worth telling.
  std::optional<VisitEvent> Look();
  [[nodiscard]] std::optional<double> Distance(const Foreground& foreground);
  void NameVisit(uint32_t visit);
  [[nodiscard]] CaptureRequest RequestFor(const action::StartCapture& job) const;
  // Stopped by nobody's wish.
  [[nodiscard]] bool LightTaken() const;
  // After a job: takes a visitor's stop back, and tells what only an operator's reset does.
  void SettleStop();
  void Tell(const VisitEvent& event);
  void Wake();
  [[nodiscard]] bool cancelled() const;

  CaptureStation& station_;
  const WorkerOptions options_;
  StopToken& stop_;
  Logger& logger_;
  Foreground foreground_;  // of the last look that found one
  std::vector<Finding> prescan_;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<VisitAction> jobs_;
  std::vector<VisitEvent> told_;
  VisitNames names_;
  bool lighting_ = false;   // a job that makes light runs
  bool cancelled_ = false;  // it was told to end
  bool ending_ = false;
  std::optional<WorkInHand> in_hand_;
  UniqueFd wake_;
  ForgetSearch search_;
  VisitForgetting forgetting_;
  std::thread thread_;
};

}  // namespace stratalux::rig

// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/forget_search.h"

#include <chrono>
#include <exception>
#include <future>
#include <string>
#include <utility>

#include <malloc.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace stratalux::rig {
namespace {

constexpr auto kBusyPause = std::chrono::seconds(1);  // while another program writes to the store

// Of this thread alone, for its whole life: who has no special rights cannot go back. What the system refuses costs the
// search its politeness, nothing else.
void GiveWay() {
  constexpr int kLowest = 19;
  const auto thread = static_cast<id_t>(syscall(SYS_gettid));
  (void)setpriority(PRIO_PROCESS, thread, kLowest);
  constexpr int kOfThread = 1, kIdleClass = 3 << 13;  // linux/ioprio.h: reads when nobody else does
  (void)syscall(SYS_ioprio_set, kOfThread, thread, kIdleClass);
}

}  // namespace

ForgetSearch::ForgetSearch(std::function<void()> found, Logger& logger)
    : found_(std::move(found)), logger_(logger), thread_([this] { Work(); }) {}

ForgetSearch::~ForgetSearch() {
  {
    const std::scoped_lock lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void ForgetSearch::Add(db::ForgetProof proof) {
  {
    const std::scoped_lock lock(mutex_);
    // Each begun one takes up what is not proven yet: a row of them would hold, and search for, everybody many times.
    if (waiting_) proof.Include(std::move(*waiting_));
    waiting_ = std::move(proof);
  }
  changed_.notify_all();
}

void ForgetSearch::SetRest(bool rest) {
  {
    const std::scoped_lock lock(mutex_);
    rest_ = rest;
  }
  changed_.notify_all();
}

bool ForgetSearch::goes_on() const {
  const std::scoped_lock lock(mutex_);
  return !ending_;
}

bool ForgetSearch::at_rest() const {
  const std::scoped_lock lock(mutex_);
  return rest_ && !ending_;
}

void ForgetSearch::Work() {
  while (true) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return ending_ || waiting_; });
    if (ending_) return;
    db::ForgetProof proof = *std::exchange(waiting_, std::nullopt);
    lock.unlock();
    try {
      Prove(std::move(proof));
    } catch (const std::exception& error) {
      logger_.Error(std::string("a search for what was forgotten failed: ") + error.what());
      found_();
    }
    // What was sought, a thousand words a visit, goes back to the machine: the program is to stay as large as it was.
    malloc_trim(0);
  }
}

void ForgetSearch::Prove(db::ForgetProof proof) {
  // What follows holds locks that others wait for, and is done at the priority of all.
  std::future<Status> search = std::async(std::launch::async, [&] {
    GiveWay();
    return proof.Search(logger_, [this] { return goes_on(); });
  });
  Status searched = search.get();
  if (searched.ok() && proof.NeedsIndexRewritten()) searched = RewriteIndex(proof);
  if (!goes_on()) return;
  if (!searched.ok()) {
    logger_.Error("the search after a forgetting: " + searched.message() +
                  "; `stratalux-db forget --resume` searches again");
    return found_();
  }
  const Result<db::ForgetReport> report = proof.Certify();
  if (!report.ok()) logger_.Error("a forgetting could not be certified: " + report.status().message());
  if (report.ok())
    for (const std::string& leftover : report->leftovers)
      logger_.Error("forgotten, but still there: " + leftover +
                    "; remove it by hand, then `stratalux-db forget --resume` searches again");
  if (!report.ok() || !report->leftovers.empty()) found_();
}

// When nobody is served, and the worker writes nothing. Whoever comes ends it, as does the program's end; it begins
// anew when they are gone.
Status ForgetSearch::RewriteIndex(db::ForgetProof& proof) {
  while (true) {
    {
      const auto turn = Turn();
      bool now = false;
      {
        const std::scoped_lock lock(mutex_);
        if (ending_) return Status(StatusCode::kTryAgain, "the program ends");
        now = rest_;
      }
      if (now) {
        Status rewritten = proof.RewriteIndex([this] { return at_rest(); });
        if (rewritten.code() != StatusCode::kBusy && rewritten.code() != StatusCode::kTryAgain) return rewritten;
      }
    }
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, kBusyPause, [this] { return ending_; });
  }
}

}  // namespace stratalux::rig

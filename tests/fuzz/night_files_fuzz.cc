// SPDX-License-Identifier: Apache-2.0
// What machines of a cluster hand each other: the plan of a night, a shard's results, and the lines of a night's log;
// the first two as they lie there and with an own hash that fits.
#include "db/base/own_hash.h"
#include "fitter/batch/shard_manifest.h"
#include "fitter/batch/shard_plan.h"
#include "tests/fuzz/target.h"

namespace {

using namespace stratalux;

void Read(const fuzz::InputFolder& folder, const std::string& text) {
  const std::span bytes(reinterpret_cast<const uint8_t*>(text.data()), text.size());
  folder.Put("plan.json", bytes);
  if (const auto plan = fit::ReadPlan(folder.path()); fuzz::Judge(plan)) {
    for (const auto& visit : plan->visits)
      if (!fit::CheckId(visit.session).ok()) fuzz::Fault("a planned visitor whose name leaves the folder");
    for (const auto& event : plan->left_out)
      if (!fit::CheckId(event.session).ok() || event.kind != fit::NightEventKind::kLeftOut)
        fuzz::Fault("who is left out leaves the folder, or is not left out");
    (void)fit::VisitsOf(*plan, {1, 3});
    const fuzz::InputFolder copy;
    if (!fit::WritePlan(copy.path(), *plan).ok()) fuzz::Fault("a plan that was read is not written");
    const auto again = fit::ReadPlan(copy.path());
    if (!again.ok() || again->visits.size() != plan->visits.size()) fuzz::Fault("a plan that was written is not read");
  }
  fit::ShardPlan plan;
  plan.id = "p";
  const auto manifest = fit::ReadManifest(folder.Put("shard.json", bytes), plan);
  if (!fuzz::Judge(manifest)) return;
  for (const fit::ShardVisit& visit : manifest->visits) {
    if (!fit::CheckId(visit.end.session).ok() || !fit::IsEnd(visit.end.kind))
      fuzz::Fault("a visitor's end that leaves the folder, or is none");
    for (const fit::MadeFolder& made : visit.made)
      if (made.place.find("../") != std::string::npos) fuzz::Fault("a folder outside the results");
  }
  const fuzz::InputFolder copy;
  if (!fit::WriteManifest(copy.path(), *manifest).ok()) fuzz::Fault("results that were read are not written");
  if (!fit::ReadManifest(fit::ManifestFile(copy.path(), manifest->shard), plan).ok())
    fuzz::Fault("results that were written are not read");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const fuzz::InputFolder folder;
  const std::string text = fuzz::TextOf(data, size);
  if (const auto event = fit::ParseNightEvent(text); fuzz::Judge(event)) {
    const auto again = fit::ParseNightEvent(fit::ToJson(*event));
    if (!again.ok() || again->kind != event->kind || again->session != event->session)
      fuzz::Fault("an event that was written is not read");
  }
  Read(folder, text);
  if (text.ends_with("\n}")) Read(folder, db::WithOwnHash(text));
  return 0;
}

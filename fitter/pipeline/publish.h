// SPDX-License-Identifier: Apache-2.0
// A fit of the store: a folder of its own names for the artifacts' files (hard links), report and figures, entered in
// the index in one transaction (db/catalogue/fit_store.h).
//
// It is made in fits/<fit>.partial and put in the place of an earlier one of the same id in one step, so a fit is there
// whole, with its first report or with its evaluation, whenever the process ends.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "fitter/pipeline/session_graph.h"
#include "fitter/report/html_report.h"

namespace stratalux::fit {

// first: the fit and what the report shows; held_out: baselines, too; full: all that --full-evaluation asks for.
enum class Evaluation { kFirst, kHeldOut, kFull };
[[nodiscard]] const char* ToString(Evaluation evaluation);

// Models that a comparison of that evaluation holds, the judged one first.
[[nodiscard]] std::vector<std::string> ModelsOf(SessionGraph& graph, Evaluation evaluation, GeometrySource source,
                                                int heldout);

// Keys of the stages that a fit with that evaluation asks for; not those that only an earlier evaluation asks for.
[[nodiscard]] std::vector<std::string> KeysOf(SessionGraph& graph, const RunOptions& options, Evaluation evaluation);

// Of all that makes the fit, whatever is compared with it: 16 hex digits.
[[nodiscard]] std::string FitIdOf(SessionGraph& graph, const RunOptions& options);
// What killed runs left of fits that they were putting in their place: half made ones go; this fit, if it is whole and
// not listed, or with the figures of before, is entered.
[[nodiscard]] Status SettleFits(SessionGraph& graph, const SessionFrames& frames, const std::string& fit);
// What a listed fit holds; nullopt: there is none, or one that stages of another version were compared for. kIntegrity
// names the file that is not what fit.json says.
[[nodiscard]] Result<std::optional<Evaluation>> EvaluationHeld(SessionGraph& graph, const RunOptions& options,
                                                               const SessionFrames& frames, const std::string& fit);

// Held by whoever puts the fit in its place: one at a time.
[[nodiscard]] std::string LockOfFit(const std::string& fit);
// `made` in the place of `place`, which may be there, in one step.
Status PutInPlace(const std::filesystem::path& made, const std::filesystem::path& place);

// Runs what is missing and enters the fit; its folder. `pictures`: of the reports that this run wrote before.
[[nodiscard]] Result<std::filesystem::path> Publish(SessionGraph& graph, const RunOptions& options,
                                                    SessionFrames& frames, Evaluation evaluation,
                                                    KnownPictures& pictures);

}  // namespace stratalux::fit

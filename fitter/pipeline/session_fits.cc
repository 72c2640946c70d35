// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/session_fits.h"

#include <set>

#include "db/catalogue/fit_record.h"
#include "fitter/session/choose_session.h"
#include "fitter/session/session_frames.h"

namespace stratalux::fit {

Result<CleanReport> CleanArtifacts(const std::string& store, const std::string& session, const CleanOptions& options,
                                   Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(store, session, SessionUse::kVisitor, logger));
  SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(store, chosen));
  SLX_ASSIGN_OR_RETURN(auto artifacts, ArtifactStore::Open(frames.folder(), logger));
  SLX_ASSIGN_OR_RETURN(const auto fits, frames.store().ListFits(frames.info().id));
  std::set<std::string> wanted;
  for (const db::FitRow& fit : fits) {
    const auto row = db::ReadFitRecord(frames.store().FitFolder(frames.info().id, fit.id), frames.info().id);
    if (row.ok())
      for (const auto& [stage, folder] : row->artifacts) wanted.insert(folder);
  }
  return artifacts.Clean(wanted, options);
}

Result<std::filesystem::path> NewestFit(const std::string& store_folder, const std::string& session, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(store_folder, session, SessionUse::kFit, logger));
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(store_folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto row, store.FindSession(chosen));
  SLX_ASSIGN_OR_RETURN(const auto fits, store.ListFits(row.info.id));
  if (fits.empty())
    return Status::NotFound("session " + row.info.id + " has no complete fit (`stratalux-fit run " + row.info.id +
                            "`)");
  return store.FitFolder(row.info.id, fits[0].id);
}

}  // namespace stratalux::fit

// SPDX-License-Identifier: Apache-2.0
#include "db/care/verify_seals.h"

#include <algorithm>
#include <filesystem>

#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/keys/readers.h"
#include "db/keys/rig_key.h"
#include "db/keys/sealed_key.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

class SealChecker {
 public:
  SealChecker(const SessionStore& store, const SessionRow& session, VerifyDepth depth, VerifyReport& report)
      : seal_(SealOf(store.folder(), session.info, session.key_id)),
        session_(session.info.id),
        depth_(depth),
        report_(report) {}
  [[nodiscard]] bool active() const { return seal_.active(); }

  void CheckArtifact(const fs::path& folder) {
    const auto record = ReadArtifactRecord(folder);
    if (!record.ok()) return;  // damaged: who reads all bytes says so
    const std::string name = folder.filename().string();
    if (record->identity.seal != seal_.key_id())
      return report_.problems.push_back(folder.string() +
                                        ": plain artifact of an encrypted session, made by an older program; "
                                        "`stratalux-fit clean " +
                                        session_ + "` removes it");
    for (const RecordedFile& file : record->files) {
      const Status sealed = CheckFile(folder / file.name, {PlaceOfArtifact(name, file.name)});
      if (sealed.ok()) continue;
      return report_.problems.push_back(sealed.message() + " (`stratalux-fit clean " + session_ +
                                        " --damaged` removes the artifact; it is made again)");
    }
  }

  void CheckFit(const fs::path& folder) {
    const auto names = NamesOfFiles(folder, kFitRecordFile);
    const auto fit = ReadFitRecord(folder, session_);
    if (!names.ok() || !fit.ok()) return;  // as above
    for (const std::string& name : *names) {
      if (FitFilesLeftPlain().contains(name)) continue;
      const auto header = ReadSealedHeader(folder / name);
      if (header.ok() && !*header)
        return report_.problems.push_back(folder.string() + ": plain fit of an encrypted session (" + name +
                                          "), made by an older program; `stratalux-fit clean " + session_ +
                                          "` seals it");
      if (const Status sealed = CheckFile(folder / name, PlacesOfFitFile(*fit, name)); !sealed.ok())
        report_.problems.push_back(sealed.message());
    }
  }

  void NoteUnopened() const {
    if (unopened_ > 0)
      report_.notes.push_back("session " + session_ + ": " + std::to_string(unopened_) +
                              " sealed files were hashed, but not opened: their key is not here");
  }

 private:
  Status CheckFile(const fs::path& file, const std::set<std::string>& places) {
    if (depth_ == VerifyDepth::kHeaders) return seal_.CheckHeader(file, places);
    const Status opened = seal_.Check(file, places);
    if (opened.code() != StatusCode::kNotFound) return opened;
    ++unopened_;
    return Status::Ok();
  }

  FileSeal seal_;
  std::string session_;
  VerifyDepth depth_;
  VerifyReport& report_;
  int64_t unopened_ = 0;
};

}  // namespace

void CheckSeals(const SessionStore& store, const SessionRow& session, VerifyDepth depth, VerifyReport& report) {
  SealChecker checker(store, session, depth, report);
  if (!checker.active()) return;
  std::error_code error;
  const std::string& id = session.info.id;
  for (const auto& entry : fs::directory_iterator(store.SessionFolder(id) / kArtifactsFolder, error))
    if (!entry.path().filename().string().starts_with(".")) checker.CheckArtifact(entry.path());
  const auto fits = store.ListFits(id);
  if (!fits.ok()) return report.problems.push_back(fits.status().message());
  for (const FitRow& fit : *fits)
    if (fs::exists(store.FitFolder(id, fit.id), error)) checker.CheckFit(store.FitFolder(id, fit.id));
  checker.NoteUnopened();
}

void CheckSealedKeys(const SessionStore& store, const SessionRow& session, VerifyReport& report) {
  const std::string& id = session.info.id;
  const fs::path folder = store.SessionFolder(id);
  const auto files = ListSealedKeys(folder);
  KeyId key{};
  if (!FromHex(session.key_id, key).ok()) {
    for (const fs::path& file : files)
      report.problems.push_back(file.string() + " is a sealed key, but its session is not encrypted: remove it");
    return;
  }
  for (const fs::path& file : files)
    if (const Status right = CheckSealedKey(file, id, key); !right.ok()) report.problems.push_back(right.message());
  // A copy of the session elsewhere has the keys that came with it, for readers that its store need not know.
  if (!FindKey(store.folder(), key).ok()) return;
  const auto readers = ListReaders(store.folder());
  if (!readers.ok()) return;  // said once, of the store
  std::vector<fs::path> wanted;
  for (const ReaderPublicKey& reader : *readers) {
    wanted.push_back(SealedKeyFile(folder, IdOf(reader)));
    if (std::find(files.begin(), files.end(), wanted.back()) == files.end())
      report.notes.push_back("session " + id + ": its key is not sealed to reader " + ToHex(IdOf(reader)) +
                             " (`stratalux-db key share`)");
  }
  for (const fs::path& file : files)
    if (std::find(wanted.begin(), wanted.end(), file) == wanted.end())
      report.problems.push_back(
          file.string() +
          " is sealed to someone who is not a reader of this store: `stratalux-db key unshare` with"
          " the id in its name removes it");
}

}  // namespace stratalux::db

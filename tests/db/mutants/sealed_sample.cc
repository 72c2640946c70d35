// SPDX-License-Identifier: Apache-2.0
#include "tests/db/mutants/sealed_sample.h"

#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_reader.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMetrics = R"({"fit": {"divergence": 0.5}})";

Status PutSealed(FileSeal& seal, const std::string& text, const std::string& place, const fs::path& file) {
  const fs::path plain = file.string() + ".plain";
  fs::create_directories(file.parent_path());
  WriteText(plain, text);
  const Status sealed = seal.Seal(plain, place, file);
  fs::remove(plain);
  return sealed;
}

}  // namespace

Status FitSealed(SessionStore& store, const std::string& session) {
  SLX_ASSIGN_OR_RETURN(FileSeal seal, FindSeal(store, session));
  ArtifactRecord record;
  record.identity = {.stage = "shape", .inputs = {{"decode", std::string(32, '7')}}, .isa = "", .seal = seal.key_id()};
  const std::string name = record.identity.FolderName();
  const fs::path artifact = store.SessionFolder(session) / kArtifactsFolder / name;
  std::string map(kSealedPieceBytes + 900, '\0');
  for (size_t i = 0; i < map.size(); ++i) map[i] = static_cast<char>(i * 2654435761U >> 24U);
  for (const auto& [file, text] : {std::pair<std::string, std::string>("position.exr", map), {"mesh.ply", "ply\n"}})
    SLX_RETURN_IF_ERROR(PutSealed(seal, text, PlaceOfArtifact(name, file), artifact / file));
  SLX_ASSIGN_OR_RETURN(record.files, ListFiles(artifact, kArtifactRecordFile));
  record.program = "a test";
  WriteText(artifact / kArtifactRecordFile, ToJson(record));

  const fs::path fit = store.FitFolder(session, "f1");
  fs::create_directories(fit);
  fs::copy_file(artifact / "mesh.ply", fit / "mesh.ply");
  SLX_RETURN_IF_ERROR(
      PutSealed(seal, "<h1>a face</h1>", PlaceOfFit("f1") + "/report/index.html", fit / "report" / "index.html"));
  WriteText(fit / "metrics.json", kMetrics);
  FitRow row{"f1", session, R"({"eta":1.4})", kMetrics, {17'000}};
  row.artifacts = {{"shape", name}};
  return store.RegisterFit(row);
}

}  // namespace stratalux::db

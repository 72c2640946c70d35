// SPDX-License-Identifier: Apache-2.0
// manifest.json of a session, as it lies there and with an own hash that fits.
#include "db/base/own_hash.h"
#include "db/catalogue/info_check.h"
#include "db/catalogue/manifest.h"
#include "tests/fuzz/target.h"

namespace {

using namespace stratalux;

void Read(const std::filesystem::path& folder, const std::string& text) {
  const auto info = db::ReadManifest(folder);
  if (fuzz::Judge(info)) {
    fuzz::Judge(db::CheckInfo(*info));
    // What was read can be written again.
    (void)db::ManifestText(folder, *info, 0, {});
  }
  (void)fuzz::Judge(db::ReadManifestContents(folder));
  (void)db::LastingFacts(text);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const fuzz::InputFolder folder;
  const std::string text = fuzz::TextOf(data, size);
  folder.Put("manifest.json", {data, size});
  Read(folder.path(), text);
  if (!text.ends_with("\n}")) return 0;
  const std::string hashed = db::WithOwnHash(text);
  folder.Put("manifest.json", {reinterpret_cast<const uint8_t*>(hashed.data()), hashed.size()});
  Read(folder.path(), hashed);
  (void)db::ReasonsFromJson(text);
  (void)db::ConsentFromJson(text);
  (void)db::FoundFromJson(text, text);
  return 0;
}

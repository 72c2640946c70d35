// SPDX-License-Identifier: Apache-2.0
// Sealed keys. The first byte says what the others are: the file as it lies there; one whose digest is made to fit; or
// a change of a file that was sealed rightly, perhaps with its digest made to fit as well.
#include <algorithm>
#include <cstring>
#include <fstream>
#include <iterator>
#include <optional>
#include <vector>

#include <sodium.h>

#include "db/keys/sealed_key.h"
#include "tests/fuzz/target.h"

namespace {

using namespace stratalux;
using namespace stratalux::db;
namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;

constexpr const char* kSession = "s000017-0badcafe";
constexpr size_t kDigestBytes = 16;

void FitDigest(Bytes& bytes) {
  if (bytes.size() < kDigestBytes) return;
  uint8_t digest[32];
  crypto_generichash(digest, sizeof digest, bytes.data(), bytes.size() - kDigestBytes, nullptr, 0);
  std::copy_n(digest, kDigestBytes, bytes.end() - kDigestBytes);
}

// A session with one key, the same in every run, and a reader, of every run another.
class Vault {
 public:
  Vault() : reader_(MakeReader()) {
    auto secret = std::make_shared<SecretKey>();
    secret->bytes.fill(0x5a);
    key_.id.fill(0x77);
    key_.key = std::move(secret);
    if (!WriteSealedKey(folder_.path(), kSession, key_, reader_->public_key()).ok())
      fuzz::Fault("a key cannot be sealed");
    file_ = SealedKeyFile(folder_.path(), IdOf(reader_->public_key()));
    std::ifstream in(file_, std::ios::binary);
    whole_ = Bytes(std::istreambuf_iterator<char>(in), {});
  }
  [[nodiscard]] const Bytes& whole() const { return whole_; }

  // Whether it opens, as the session's key.
  bool Open(const Bytes& bytes) {
    folder_.Put(file_.filename().string(), bytes);
    const auto header = ReadSealedKeyHeader(file_);
    const bool read = fuzz::Judge(header);
    const Status said = CheckSealedKey(file_, kSession, key_.id);
    const auto opened = OpenSealedKey(folder_.path(), kSession, key_.id, *reader_);
    const auto other = OpenSealedKey(folder_.path(), "s000018-0badcafe", key_.id, *reader_);
    fuzz::Judge(said);
    fuzz::Judge(opened);
    if (fuzz::Judge(other)) fuzz::Fault("the key of a session opened as another's");
    if (said.ok() && !read) fuzz::Fault("right, though it cannot be read");
    if (opened.ok() && !said.ok()) fuzz::Fault("opened against its header");
    if (opened.ok() && (opened->id != key_.id || opened->key->bytes != key_.key->bytes)) fuzz::Fault("another key");
    return opened.ok();
  }

 private:
  std::optional<ReaderKey> MakeReader() const {
    auto made = ReaderKey::Create(folder_.path() / "reader.key");
    if (!made.ok()) fuzz::Fault("no reader");
    return std::move(*made);
  }

  fuzz::InputFolder folder_;
  std::optional<ReaderKey> reader_;
  fs::path file_;
  SessionKey key_;
  Bytes whole_;
};

// `order`: how, where, a value, whether the digest is made to fit; then bytes to put there.
void ReadChanged(Vault& vault, std::span<const uint8_t> order) {
  constexpr size_t kOrder = 4;
  if (order.size() < kOrder) return;
  Bytes changed = vault.whole();
  const size_t at = order[1] % changed.size();
  const auto place = changed.begin() + static_cast<std::ptrdiff_t>(at);
  const auto rest = order.subspan(kOrder);
  switch (order[0] % 4) {
    case 0:
      changed[at] ^= order[2];
      break;
    case 1:
      changed.resize(at);
      break;
    case 2:
      changed.insert(place, rest.begin(), rest.end());
      break;
    default:
      std::copy_n(rest.begin(), std::min(rest.size(), changed.size() - at), place);
  }
  if ((order[3] & 1) != 0) FitDigest(changed);
  if (vault.Open(changed) != (changed == vault.whole())) fuzz::Fault("opened though changed, or not though whole");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0 || sodium_init() < 0) return 0;
  static Vault vault;
  Bytes rest(data + 1, data + size);
  if (data[0] % 3 == 1) FitDigest(rest);
  // Of a reader whose key nobody else has, none of a stranger's making opens.
  if (data[0] % 3 != 2 && vault.Open(rest)) fuzz::Fault("a forged file opened");
  if (data[0] % 3 == 2) ReadChanged(vault, std::span<const uint8_t>(data + 1, size - 1));
  return 0;
}

// SPDX-License-Identifier: Apache-2.0
// `stratalux-db key export|import`, `key sign-init|public`, `key reader-init|reader-public|share|unshare|readers`.
#include <cstdio>
#include <functional>
#include <memory>
#include <optional>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/keys/rig_key.h"
#include "db/privacy/key_file.h"
#include "db/privacy/key_sharing.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

struct KeyFlags {
  std::string session, file, reader;
};

int ExportKey(const CommonFlags& common, const KeyFlags& flags) {
  const auto store = SessionStore::Open(common.store, AccessMode::kReadOnly);
  if (!store.ok()) return Report(store.status());
  const auto row = store->FindSession(flags.session);
  if (!row.ok()) return Report(row.status());
  const Status status = ExportKeyFile(common.store, *row, flags.file);
  if (!status.ok()) return Report(status);
  const Json json = {{"session", row->info.id}, {"key_id", row->key_id}, {"file", flags.file}};
  return Print(common.json ? TextOf(json) : "key of session " + row->info.id + " written to " + flags.file + "\n");
}

int ImportKey(const CommonFlags& common, const KeyFlags& flags) {
  const auto session = ImportKeyFile(common.store, flags.file);
  if (!session.ok()) return Report(session.status());
  const Json json = {{"session", *session}};
  return Print(common.json ? TextOf(json) : "session " + *session + " can be read here; delete " + flags.file + "\n");
}

// The rig's key: made, or its public half printed.
int PrintRigKey(const CommonFlags& common, Result<RigKey> (*key_of)(const std::filesystem::path&)) {
  // Where there is no store, there is nothing to sign.
  if (const auto store = SessionStore::Open(common.store, AccessMode::kReadOnly); !store.ok())
    return Report(store.status());
  const auto key = key_of(common.store);
  if (!key.ok()) return Report(key.status());
  const Json json = {{"public_key", ToHex(key->public_key())}, {"fingerprint", Fingerprint(key->public_key())}};
  return Print(common.json ? TextOf(json) : ToHex(key->public_key()) + "\n");
}

int PrintReaderKey(const CommonFlags& common, const Result<ReaderKey>& key) {
  if (!key.ok()) return Report(key.status());
  const Json json = {{"public_key", ToText(key->public_key())}, {"reader", ToHex(IdOf(key->public_key()))}};
  return Print(common.json ? TextOf(json) : ToText(key->public_key()) + "\n");
}

int Share(const CommonFlags& common, const KeyFlags& flags) {
  std::optional<ReaderPublicKey> reader;
  if (!flags.reader.empty()) {
    const auto parsed = ParseReaderPublicKey(flags.reader);
    if (!parsed.ok()) return Report(parsed.status());
    reader = *parsed;
  }
  const auto shared = ShareKeys(common.store, reader);
  if (!shared.ok()) return Report(shared.status());
  const Json json = {{"readers", shared->readers},
                     {"sessions", shared->sessions},
                     {"sealed", shared->sealed},
                     {"not_sealed", shared->not_sealed}};
  std::string text = std::to_string(shared->sealed) + " keys sealed; " + std::to_string(shared->readers) +
                     " reader(s), " + std::to_string(shared->sessions) + " encrypted sessions\n";
  for (const std::string& missing : shared->not_sealed) text += "  not sealed: " + missing + "\n";
  const int printed = Print(common.json ? TextOf(json) : text);
  return shared->not_sealed.empty() || printed != 0 ? printed : static_cast<int>(StatusCode::kDegraded);
}

int Unshare(const CommonFlags& common, const KeyFlags& flags) {
  const auto reader = FindReader(common.store, flags.reader);
  if (!reader.ok()) return Report(reader.status());
  const auto removed = UnshareKeys(common.store, *reader);
  if (!removed.ok()) return Report(removed.status());
  const Json json = {{"reader", ToHex(*reader)}, {"removed", *removed}};
  return Print(common.json ? TextOf(json)
                           : "reader " + ToHex(*reader) + " removed, with " + std::to_string(*removed) +
                                 " sealed keys; copies that a pull has already fetched stay where they are\n");
}

int ShowReaders(const CommonFlags& common) {
  const auto rows = ListSharing(common.store);
  if (!rows.ok()) return Report(rows.status());
  Json json = Json::array();
  std::string text = "reader                            sealed  public key\n";
  for (const ReaderRow& row : *rows) {
    json.push_back(
        {{"reader", ToHex(row.id)}, {"sealed", row.sealed}, {"public_key", row.key ? Json(ToText(*row.key)) : Json()}});
    char line[64];
    std::snprintf(line, sizeof line, "  %6lld  ", static_cast<long long>(row.sealed));
    text += ToHex(row.id) + line + (row.key ? ToText(*row.key) : "not a reader of this store") + "\n";
  }
  return Print(common.json ? TextOf(json) : text + (rows->empty() ? "(none)\n" : ""));
}

}  // namespace

void AddKeyCommand(Commands& commands) {
  const auto flags = std::make_shared<KeyFlags>();
  struct Verb {
    std::function<int()> run;
    bool needs_store = true;
  };
  const auto chosen = std::make_shared<Verb>();
  const CommonFlags& common = commands.flags();
  CLI::App* key = commands.Add(
      "key", "Keys of encrypted sessions, and the key that signs this rig's sessions",
      [chosen] { return chosen->run(); }, [chosen] { return chosen->needs_store; });
  key->footer(
      Examples({"key export s000017 --out s000017.key", "key import s000017.key", "key sign-init > rig-1.pub",
                "key reader-init --out reader.key > workstation.pub", "key share workstation.pub --store store",
                "key readers", "key unshare 3f5c"},
               "A reader fits encrypted sessions on another machine: run `reader-init` there, `share` on the rig."));
  key->require_subcommand(1);
  key->fallthrough();
  const auto add = [key, chosen](const char* name, const char* description, const std::function<int()>& run) {
    CLI::App* verb = key->add_subcommand(name, description);
    verb->fallthrough();
    // The reader's own key lies in no store.
    verb->callback([chosen, run, needs_store = std::string(name).find("reader-") != 0] {
      *chosen = {run, needs_store};
    });
    return verb;
  };
  CLI::App* take_out = add("export", "Write the key to a file that only you can read; logged",
                           [&common, flags] { return ExportKey(common, *flags); });
  take_out->add_option("SESSION", flags->session, "id, unique prefix, or latest")->required();
  take_out->add_option("--out", flags->file, "file to write")->required();
  add("import", "Import the key in FILE", [&common, flags] { return ImportKey(common, *flags); })
      ->add_option("FILE", flags->file, "file that `key export` wrote")
      ->required();
  add("sign-init", "Make the key that signs sessions; print its public half",
      [&common] { return PrintRigKey(common, RigKey::Create); });
  add("public", "Print the public half of that key, for auditors",
      [&common] { return PrintRigKey(common, RigKey::Read); });
  add("reader-init", "Make a reader's key pair; print its public half",
      [&common, flags] { return PrintReaderKey(common, ReaderKey::Create(flags->file)); })
      ->add_option("--out", flags->file, "file for the private half (mode 0600), outside any store")
      ->required();
  add("reader-public", "Print the public half of a reader's key", [&common, flags] {
    return PrintReaderKey(common, flags->file.empty() ? ReaderKey::OfEnvironment() : ReaderKey::Read(flags->file));
  })->add_option("FILE", flags->file, "file that reader-init wrote (default: $STRATALUX_READER_KEY)");
  add("share", "Seal the keys of the sessions here, and of each new one as it begins, to a reader", [&common, flags] {
    return Share(common, *flags);
  })->add_option("PUBLIC", flags->reader, "public key, or a file that holds it (default: the store's readers)");
  add("unshare", "Remove a reader and the keys that are sealed to it here",
      [&common, flags] { return Unshare(common, *flags); })
      ->add_option("READER", flags->reader, "start of its id, or its public key")
      ->required();
  add("readers", "List the readers", [&common] { return ShowReaders(common); });
}

}  // namespace stratalux::db

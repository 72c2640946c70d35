// SPDX-License-Identifier: Apache-2.0
// signature.json of a session: the rig's Ed25519 signature, by which an auditor tells the session from a forgery
// (docs/file-formats.md).
//
// Signed is what a lossless transcode leaves as it is: the manifest without its list of files, every frame's header
// without codec, stored size and stored hash, and the BLAKE2b-256 of every frame's samples (of an encrypted frame: of
// its stored bytes, so that an auditor needs no key; those are never transcoded). The hashes of segments and manifests
// are XXH3, which finds accidents; whoever can compute them anew is stopped by this alone. Fits are not signed.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "db/keys/rig_key.h"
#include "shared/capture/session.h"

namespace stratalux::db {

struct SessionSignature {
  std::string session;
  PublicKey public_key{};
  std::vector<Digest> frames;           // samples, by frame number
  std::map<std::string, Digest> files;  // truth.seg, truth_calibration.json: all their bytes
  Ed25519Signature signature{};
};

enum class EndingSignature { kNone, kByRigKey };

// Ends a session on the disk: signature.json (kByRigKey; else one that is there goes), then manifest.json. Reads every
// frame of `segments` again on all cores. Nothing is left half: without its manifest a signature means nothing.
Status WriteEnding(const std::filesystem::path& store, const SessionInfo& info, int64_t frames,
                   const std::vector<std::string>& segments, EndingSignature signature);

// nullopt where the session is not signed; kIntegrity, kNewerSchema.
[[nodiscard]] Result<std::optional<SessionSignature>> ReadSignature(const std::filesystem::path& session_folder);

enum class SignatureDepth { kHeaders, kPixels };
struct SignatureReport {
  std::optional<PublicKey> signed_by;  // whatever the outcome; nothing: there is no signature to read
  std::vector<std::string> problems;   // each names the file, and the frame where one can be told
};
// Holds a session against its signature. kHeaders trusts the listed digests of the samples for what they say of the
// headers; kPixels computes them anew.
[[nodiscard]] SignatureReport CheckSignature(const std::filesystem::path& session_folder, SignatureDepth depth);

}  // namespace stratalux::db

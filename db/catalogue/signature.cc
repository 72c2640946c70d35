// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/signature.h"

#include <algorithm>
#include <cstring>
#include <system_error>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/catalogue/manifest.h"
#include "db/segment/frame_codec.h"
#include "db/segment/segment.h"
#include "shared/base/parallel.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kFile = "signature.json";
constexpr const char* kAlgorithm = "ed25519-blake2b256";
constexpr int kSignatureSchema = 1;

// The frames of a session where they lie, by number.
struct Frames {
  struct Place {
    const SegmentReader* segment;
    SegmentFrame frame;
  };
  std::vector<std::unique_ptr<SegmentReader>> segments;
  std::vector<Place> places;
};

Result<Frames> FindFrames(const fs::path& folder, const std::vector<std::string>& segments) {
  Frames frames;
  for (const std::string& name : segments) {
    if (name.empty() || name.find('/') != std::string::npos)
      return Status::Integrity("'" + name + "' is not a segment");
    SLX_ASSIGN_OR_RETURN(auto reader, SegmentReader::Open(folder / name));
    bool sealed = false;
    SLX_ASSIGN_OR_RETURN(const auto found, reader.Walk(false, &sealed));
    frames.segments.push_back(std::make_unique<SegmentReader>(std::move(reader)));
    for (const SegmentFrame& frame : found) frames.places.push_back({frames.segments.back().get(), frame});
  }
  std::stable_sort(frames.places.begin(), frames.places.end(),
                   [](const auto& a, const auto& b) { return a.frame.header.frame < b.frame.header.frame; });
  return frames;
}

// Of the samples at their format's width, little-endian; of an encrypted frame's stored bytes.
Result<Digest> DigestOfFrame(const Frames::Place& place, FrameDecoder& decoder, std::vector<uint8_t>& buffer) {
  const FrameHeader& header = place.frame.header;
  SLX_RETURN_IF_ERROR(place.segment->ReadPayload(place.frame.offset, header, buffer));
  const auto payload = std::span<const uint8_t>(buffer).first(header.payload_bytes);
  if (header.cipher != 0) return DigestOf(payload);
  SLX_ASSIGN_OR_RETURN(const auto image, decoder.Decode(ShapeOf(header), static_cast<Codec>(header.codec), payload)
                                             .WithContext("frame " + std::to_string(header.frame)));
  const auto samples = image.pixels();
  if (static_cast<PixelFormat>(header.format) != PixelFormat::kMono8)
    return DigestOf(std::span(reinterpret_cast<const uint8_t*>(samples.data()), samples.size() * sizeof(uint16_t)));
  std::vector<uint8_t> narrow(samples.size());
  std::transform(samples.begin(), samples.end(), narrow.begin(), [](uint16_t v) { return static_cast<uint8_t>(v); });
  return DigestOf(narrow);
}

std::vector<Result<Digest>> DigestsOf(const Frames& frames) {
  std::vector<Result<Digest>> digests(frames.places.size(), Digest{});
  ParallelFor(static_cast<int64_t>(digests.size()), 8, [&](int64_t begin, int64_t end) {
    FrameDecoder decoder;
    std::vector<uint8_t> buffer;
    for (auto i = static_cast<size_t>(begin); i < static_cast<size_t>(end); ++i)
      digests[i] = DigestOfFrame(frames.places[i], decoder, buffer);
  });
  return digests;
}

// A header as every codec leaves it.
void AppendLasting(FrameHeader header, std::vector<uint8_t>& to) {
  header.codec = 0;
  header.payload_bytes = header.header_hash = 0;
  std::memset(header.payload_hash, 0, sizeof header.payload_hash);
  const auto* bytes = reinterpret_cast<const uint8_t*>(&header);
  to.insert(to.end(), bytes, bytes + sizeof header);
}

// The signed bytes (docs/file-formats.md).
std::string MessageOf(const std::string& session, const std::string& manifest, const Frames& frames,
                      const std::vector<Digest>& samples, const std::map<std::string, Digest>& files) {
  std::vector<uint8_t> headers;
  for (size_t i = 0; i < frames.places.size(); ++i) {
    AppendLasting(frames.places[i].frame.header, headers);
    headers.insert(headers.end(), samples[i].begin(), samples[i].end());
  }
  std::string message = "stratalux session signature 1\nsession " + session + "\nmanifest " +
                        ToHex(DigestOf(LastingFacts(manifest))) + "\nframes " + std::to_string(frames.places.size()) +
                        " " + ToHex(DigestOf(headers)) + "\n";
  for (const auto& [name, digest] : files) message += "file " + name + " " + ToHex(digest) + "\n";
  return message;
}

Result<std::map<std::string, Digest>> OtherFiles(const fs::path& folder) {
  std::map<std::string, Digest> files;
  std::error_code error;
  for (const char* name : {"truth.seg", "truth_calibration.json"}) {
    if (!fs::exists(folder / name, error)) continue;
    SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(folder / name));
    files[name] = DigestOf(bytes);
  }
  return files;
}

std::string TextOf(const SessionSignature& s) {
  Json frames = Json::array(), files = Json::object();
  for (const Digest& digest : s.frames) frames.push_back(ToHex(digest));
  for (const auto& [name, digest] : s.files) files[name] = ToHex(digest);
  const Json json = {{"schema", kSignatureSchema},        {"session", s.session}, {"algorithm", kAlgorithm},
                     {"public_key", ToHex(s.public_key)}, {"frames", frames},     {"files", files},
                     {"signature", ToHex(s.signature)}};
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

Status Sign(const fs::path& folder, const std::string& manifest, const std::vector<std::string>& segments,
            const RigKey& key) {
  SessionSignature signature;
  signature.session = folder.filename().string();
  signature.public_key = key.public_key();
  SLX_ASSIGN_OR_RETURN(const Frames frames, FindFrames(folder, segments));
  for (auto& digest : DigestsOf(frames)) {
    SLX_RETURN_IF_ERROR(digest.status());
    signature.frames.push_back(*digest);
  }
  SLX_ASSIGN_OR_RETURN(signature.files, OtherFiles(folder));
  signature.signature = key.Sign(MessageOf(signature.session, manifest, frames, signature.frames, signature.files));
  return ReplaceFile(folder / kFile, TextOf(signature));
}

Status TakeHex(const Json& json, std::span<uint8_t> bytes) { return FromHex(json.get<std::string>(), bytes); }

Result<SessionSignature> SignatureFrom(const Json& json) {
  const Json& schema = json.at("schema");
  if (!schema.is_number_integer() || schema < 1)
    return Status::Integrity("schema " + schema.dump() + " does not exist");
  if (schema > kSignatureSchema)
    return Status(StatusCode::kNewerSchema, "schema " + schema.dump() + " is newer than this program's");
  if (json.at("algorithm") != kAlgorithm)
    return Status(StatusCode::kNewerSchema,
                  "algorithm " + json.at("algorithm").dump() + " is not known to this program");
  SessionSignature s;
  json.at("session").get_to(s.session);
  SLX_RETURN_IF_ERROR(TakeHex(json.at("public_key"), s.public_key));
  SLX_RETURN_IF_ERROR(TakeHex(json.at("signature"), s.signature));
  if (!json.at("frames").is_array() || !json.at("files").is_object()) return Status::Integrity("no lists of digests");
  for (const Json& digest : json.at("frames")) SLX_RETURN_IF_ERROR(TakeHex(digest, s.frames.emplace_back()));
  for (const auto& [name, digest] : json.at("files").items()) SLX_RETURN_IF_ERROR(TakeHex(digest, s.files[name]));
  return s;
}

void CheckFiles(const fs::path& folder, const SessionSignature& signature, SignatureReport& report) {
  const auto files = OtherFiles(folder);
  if (!files.ok()) return report.problems.push_back(files.status().message());
  std::map<std::string, Digest> all = signature.files;
  all.insert(files->begin(), files->end());
  for (const auto& [name, digest] : all) {
    const auto signed_one = signature.files.find(name), there = files->find(name);
    if (signed_one == signature.files.end())
      report.problems.push_back((folder / name).string() + " is not among the files that were signed");
    else if (there == files->end())
      report.problems.push_back((folder / name).string() + " was signed but is missing");
    else if (there->second != signed_one->second)
      report.problems.push_back((folder / name).string() + " is not the file that was signed");
  }
}

void CheckSamples(const fs::path& folder, const Frames& frames, const SessionSignature& signature,
                  SignatureReport& report) {
  const auto digests = DigestsOf(frames);
  for (size_t i = 0; i < digests.size(); ++i) {
    const std::string frame = "frame " + std::to_string(frames.places[i].frame.header.frame);
    if (!digests[i].ok())
      report.problems.push_back(digests[i].status().message());
    else if (i < signature.frames.size() && *digests[i] != signature.frames[i])
      report.problems.push_back((folder / kFile).string() + ": " + frame + " does not show what was signed");
  }
}

}  // namespace

Status WriteEnding(const fs::path& store, const SessionInfo& info, int64_t frames,
                   const std::vector<std::string>& segments, EndingSignature signature) {
  const fs::path folder = store / "sessions" / info.id;
  const std::string manifest = ManifestText(folder, info, frames, segments);
  std::error_code error;
  if (signature == EndingSignature::kByRigKey) {
    SLX_ASSIGN_OR_RETURN(const RigKey key, RigKey::Read(store));
    SLX_RETURN_IF_ERROR(Sign(folder, manifest, segments, key));
  } else if (fs::remove(folder / kFile, error); error) {
    return Status::Failed("cannot remove " + (folder / kFile).string() + ": " + error.message());
  }
  return ReplaceFile(folder / "manifest.json", manifest);
}

Result<std::optional<SessionSignature>> ReadSignature(const fs::path& folder) {
  const fs::path file = folder / kFile;
  const auto text = ReadFile(file);
  if (text.status().code() == StatusCode::kNotFound) return std::optional<SessionSignature>();
  if (!text.ok()) return text.status();
  try {
    auto signature = SignatureFrom(Json::parse(*text));
    if (signature.status().code() == StatusCode::kUsage)
      return Status::Integrity(file.string() + ": " + signature.status().message());
    if (!signature.ok()) return signature.status().WithContext(file.string());
    return std::optional(std::move(signature).value());
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

SignatureReport CheckSignature(const fs::path& folder, SignatureDepth depth) {
  SignatureReport report;
  const std::string file = (folder / kFile).string();
  const auto fail = [&report](const std::string& problem) {
    report.problems.push_back(problem);
    return report;
  };
  const auto signature = ReadSignature(folder);
  if (!signature.ok()) return fail(signature.status().message());
  if (!*signature) return report;
  const SessionSignature& s = **signature;
  report.signed_by = s.public_key;
  if (s.session != folder.filename()) return fail(file + " is of session " + s.session);
  const auto manifest = ReadFile(folder / "manifest.json");
  const auto contents = ReadManifestContents(folder);
  if (!manifest.ok() || !contents.ok()) return fail((manifest.ok() ? contents.status() : manifest.status()).message());
  const auto frames = FindFrames(folder, contents->segments);
  if (!frames.ok()) return fail(frames.status().WithContext(file).message());
  if (frames->places.size() != s.frames.size())
    return fail(file + " signs " + std::to_string(s.frames.size()) + " frames, " +
                std::to_string(frames->places.size()) + " are there");
  if (!IsSignedBy(MessageOf(s.session, *manifest, *frames, s.frames, s.files), s.signature, s.public_key))
    fail(file + ": the signature does not match this manifest and these frame headers");
  CheckFiles(folder, s, report);
  if (depth == SignatureDepth::kPixels) CheckSamples(folder, *frames, s, report);
  return report;
}

}  // namespace stratalux::db

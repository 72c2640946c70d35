// SPDX-License-Identifier: Apache-2.0
#include "tests/db/forged_segment.h"

#include <cstddef>
#include <cstring>

#include <xxhash.h>

#include "tests/db/store_fixture.h"

namespace stratalux::db {

void ForgeHeaders(const std::filesystem::path& file, const std::function<void(FrameHeader&)>& change) {
  const auto reader = SegmentReader::Open(file);
  ASSERT_TRUE(reader.ok()) << reader.status().message();
  bool sealed = false;
  const auto frames = reader->Walk(false, &sealed);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  auto bytes = ReadBytes(file);
  const auto footer = static_cast<size_t>(reader->frames_end());
  for (size_t i = 0; i < frames->size(); ++i) {
    FrameHeader header = (*frames)[i].header;
    change(header);
    header.header_hash = XXH3_64bits(&header, offsetof(FrameHeader, header_hash));
    std::memcpy(bytes.data() + (*frames)[i].offset, &header, sizeof header);
    if (sealed) std::memcpy(bytes.data() + footer + 16 + i * sizeof header, &header, sizeof header);
  }
  if (sealed) {
    const uint64_t hash = XXH3_64bits(bytes.data() + footer, bytes.size() - 24 - footer);
    std::memcpy(bytes.data() + bytes.size() - sizeof hash, &hash, sizeof hash);
  }
  WriteBytes(file, bytes);
}

}  // namespace stratalux::db

// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/exr_file.h"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <fstream>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfStdIO.h>
#include <ImfThreading.h>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// Some lines of an image, channel by channel: OpenEXR copies values that lie side by side several times as fast as
// those of one channel among sixty.
class Strip {
 public:
  static constexpr int kLines = 64;

  Strip(int width, int channels)
      : width_(width), channels_(channels), values_(static_cast<size_t>(kLines) * width * channels) {}

  // For lines from `first` on, which need not be below the file's first.
  Imf::FrameBuffer Buffer(const std::vector<std::string>& names, int x0, int first) {
    Imf::FrameBuffer buffer;
    const auto line = static_cast<ptrdiff_t>(width_) * channels_;
    for (int c = 0; c < channels_; ++c)
      buffer.insert(
          names[c].c_str(),
          Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(values_.data() + ptrdiff_t{c} * width_ - x0 - first * line),
                     sizeof(float), sizeof(float) * line));
    return buffer;
  }
  void Take(const float* image, int lines) {
    ForEach(lines, [image](float& value, ptrdiff_t at) { value = image[at]; });
  }
  void Give(float* image, int lines) {
    ForEach(lines, [image](float& value, ptrdiff_t at) { image[at] = value; });
  }

 private:
  // Of each value, and where it lies in an image whose first line is the strip's.
  template <typename Work>
  void ForEach(int lines, const Work& work) {
    constexpr int kTile = 16;  // pixels that stay in the caches
    ParallelFor(lines, 4, [&](int64_t begin, int64_t end) {
      for (ptrdiff_t y = begin; y < end; ++y)
        for (int x0 = 0; x0 < width_; x0 += kTile)
          for (int c = 0; c < channels_; ++c)
            for (int x = x0; x < std::min(x0 + kTile, width_); ++x)
              work(values_[(y * channels_ + c) * width_ + x], (y * width_ + x) * channels_ + c);
    });
  }

  const int width_, channels_;
  std::vector<float> values_;  // [line][channel][pixel]
};

// OpenEXR's own threads (de)compress blocks of lines beside ours; the bytes do not depend on how many there are.
int CompressorThreads() {
  static const int threads = [] {
    const int most = DefaultThreadCount();
    const int count = most > 1 ? most : 0;  // 0: the calling thread alone
    Imf::setGlobalThreadCount(count);
    return count;
  }();
  return threads;
}

}  // namespace

Status WriteExr(const std::filesystem::path& file, ImageView<const float> image,
                const std::vector<std::string>& channels) {
  if (static_cast<int>(channels.size()) != image.channels())
    return Status::Failed(file.string() + ": " + std::to_string(channels.size()) + " channel names for " +
                          std::to_string(image.channels()) + " channels");
  try {
    Imf::Header header(image.width(), image.height());
    // What compresses in a map is where no face is, and runs tell that: deflate (level 1) makes files 4 % smaller and
    // takes four times as long to write them.
    header.compression() = Imf::RLE_COMPRESSION;
    for (const std::string& name : channels) header.channels().insert(name.c_str(), Imf::Channel(Imf::FLOAT));
    // OpenEXR writes the last bytes, and where each block of lines lies, in a destructor that swallows what fails: the
    // stream, which is ours, remembers it.
    std::ofstream bytes(file, std::ios::binary | std::ios::trunc);
    if (!bytes) return Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
    {
      Imf::StdOFStream stream(bytes, file.c_str());
      Imf::OutputFile out(stream, header, CompressorThreads());
      Strip strip(image.width(), image.channels());
      for (int y = 0; y < image.height(); y += Strip::kLines) {
        const int lines = std::min(Strip::kLines, image.height() - y);
        strip.Take(image.row(y), lines);
        out.setFrameBuffer(strip.Buffer(channels, 0, y));
        out.writePixels(lines);
      }
    }
    bytes.close();
    if (!bytes) return Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
  } catch (const std::exception& error) {
    return Status::Failed("cannot write " + file.string() + ": " + error.what());
  }
  return Status::Ok();
}

Result<Image<float>> ReadExr(const std::filesystem::path& file, const std::vector<std::string>& channels) {
  if (!std::filesystem::exists(file)) return Status::NotFound(file.string() + " does not exist");
  try {
    Imf::InputFile in(file.c_str(), CompressorThreads());
    for (const std::string& name : channels)
      if (in.header().channels().findChannel(name.c_str()) == nullptr)
        return Status::NotFound(file.string() + " has no channel '" + name + "'");
    const Imath::Box2i window = in.header().dataWindow();
    Image<float> image(window.max.x - window.min.x + 1, window.max.y - window.min.y + 1,
                       static_cast<int>(channels.size()));
    Strip strip(image.width(), image.channels());
    for (int y = 0; y < image.height(); y += Strip::kLines) {
      const int lines = std::min(Strip::kLines, image.height() - y);
      in.setFrameBuffer(strip.Buffer(channels, window.min.x, window.min.y + y));
      in.readPixels(window.min.y + y, window.min.y + y + lines - 1);
      strip.Give(image.row(y), lines);
    }
    return image;
  } catch (const std::exception& error) {
    return Status::Integrity("cannot read " + file.string() + ": " + error.what());
  }
}

}  // namespace stratalux::fit

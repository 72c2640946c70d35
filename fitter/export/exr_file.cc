// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/exr_file.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfThreading.h>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

Imf::FrameBuffer Interleaved(float* data, int width, int channels, const std::vector<std::string>& names) {
  Imf::FrameBuffer buffer;
  const size_t pixel = sizeof(float) * static_cast<size_t>(channels);
  for (int c = 0; c < channels; ++c)
    buffer.insert(names[c].c_str(),
                  Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(data + c), pixel, pixel * static_cast<size_t>(width)));
  return buffer;
}

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
    Imf::OutputFile out(file.c_str(), header, CompressorThreads());
    // OpenEXR's frame buffers take char*, also for writing, and do not modify it.
    out.setFrameBuffer(Interleaved(const_cast<float*>(image.data()), image.width(), image.channels(), channels));
    out.writePixels(image.height());
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
    in.setFrameBuffer(Interleaved(image.data(), image.width(), image.channels(), channels));
    in.readPixels(window.min.y, window.max.y);
    return image;
  } catch (const std::exception& error) {
    return Status::Integrity("cannot read " + file.string() + ": " + error.what());
  }
}

}  // namespace stratalux::fit

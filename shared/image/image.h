// SPDX-License-Identifier: Apache-2.0
// Image<T> and ImageView<T>: the one image type. Row-major, rows contiguous, channels interleaved.
// Integer coordinates are pixel centres (docs/conventions.md).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "shared/base/check.h"

namespace stratalux {

// That a file may claim: a few megabytes can say a thousand times that, and no camera makes as many.
inline constexpr uint64_t kMostImagePixels = uint64_t{1} << 28;

// A window on somebody else's pixels. T may be const.
template <typename T>
class ImageView {
 public:
  ImageView() = default;
  ImageView(T* data, int width, int height, int channels = 1)
      : data_(data), width_(width), height_(height), channels_(channels) {}
  template <typename U>
  requires std::is_same_v<const U, T> ImageView(
      const ImageView<U>& other)  // NOLINT(google-explicit-constructor): view of T reads as view of const T
      : data_(other.data()), width_(other.width()), height_(other.height()), channels_(other.channels()) {}

  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] int channels() const { return channels_; }
  [[nodiscard]] T* data() const { return data_; }
  [[nodiscard]] bool empty() const { return data_ == nullptr || width_ == 0 || height_ == 0; }
  [[nodiscard]] size_t size() const { return static_cast<size_t>(width_) * height_ * channels_; }
  [[nodiscard]] std::span<T> pixels() const { return {data_, size()}; }
  [[nodiscard]] T* row(int y) const { return data_ + static_cast<size_t>(y) * width_ * channels_; }
  T& operator()(int x, int y, int c = 0) const { return data_[(static_cast<size_t>(y) * width_ + x) * channels_ + c]; }
  [[nodiscard]] bool contains(int x, int y) const { return x >= 0 && y >= 0 && x < width_ && y < height_; }

 private:
  T* data_ = nullptr;
  int width_ = 0;
  int height_ = 0;
  int channels_ = 1;
};

template <typename T>
class Image {
  static_assert(!std::is_same_v<T, bool>, "use uint8_t masks: vector<bool> has no addressable pixels");

 public:
  Image() = default;
  Image(int width, int height, int channels = 1, T fill = T{})
      : width_(width),
        height_(height),
        channels_(channels),
        pixels_(static_cast<size_t>(width) * height * channels, fill) {
    SLX_CHECK(width >= 0 && height >= 0 && channels > 0);
  }

  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] int channels() const { return channels_; }
  [[nodiscard]] bool empty() const { return pixels_.empty(); }
  [[nodiscard]] size_t size() const { return pixels_.size(); }
  [[nodiscard]] T* data() { return pixels_.data(); }
  [[nodiscard]] const T* data() const { return pixels_.data(); }
  // Its pixels without it, row by row.
  [[nodiscard]] std::vector<T> TakePixels() && { return std::move(pixels_); }
  [[nodiscard]] std::span<T> pixels() { return pixels_; }
  [[nodiscard]] std::span<const T> pixels() const { return pixels_; }
  [[nodiscard]] T* row(int y) { return data() + static_cast<size_t>(y) * width_ * channels_; }
  [[nodiscard]] const T* row(int y) const { return data() + static_cast<size_t>(y) * width_ * channels_; }
  T& operator()(int x, int y, int c = 0) { return pixels_[(static_cast<size_t>(y) * width_ + x) * channels_ + c]; }
  const T& operator()(int x, int y, int c = 0) const {
    return pixels_[(static_cast<size_t>(y) * width_ + x) * channels_ + c];
  }
  [[nodiscard]] bool contains(int x, int y) const { return x >= 0 && y >= 0 && x < width_ && y < height_; }
  [[nodiscard]] ImageView<T> view() { return {data(), width_, height_, channels_}; }
  [[nodiscard]] ImageView<const T> view() const { return {data(), width_, height_, channels_}; }
  operator ImageView<T>() { return view(); }              // NOLINT(google-explicit-constructor)
  operator ImageView<const T>() const { return view(); }  // NOLINT(google-explicit-constructor)

 private:
  int width_ = 0;
  int height_ = 0;
  int channels_ = 1;
  std::vector<T> pixels_;
};

}  // namespace stratalux

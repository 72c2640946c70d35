// SPDX-License-Identifier: Apache-2.0
// What all fuzz targets share. A target is LLVMFuzzerTestOneInput() in a file of its own: any bytes are read as a
// stranger's file. libFuzzer drives it (preset `fuzz`), replay.cc gives it the kept inputs (ctest `fuzz.TARGET`).
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>

#include <stdlib.h>
#include <unistd.h>

#include "shared/base/result.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

namespace stratalux::fuzz {

[[nodiscard]] inline std::string TextOf(const uint8_t* data, size_t size) {
  return {reinterpret_cast<const char*>(data), size};
}

[[noreturn]] inline void Fault(const char* what) {
  std::fprintf(stderr, "fault: %s\n", what);
  std::abort();
}

// The law of every reader: what it read, or a refusal that says why.
inline void Judge(const Status& status) {
  if (!status.ok() && status.message().empty()) Fault("a refusal without a message");
}
template <typename T>
bool Judge(const Result<T>& result) {
  Judge(result.status());
  if (!result.ok() && result.status().ok()) Fault("neither a value nor a refusal");
  return result.ok();
}

// A folder of this process, for readers that open files; gone with it.
class InputFolder {
 public:
  InputFolder() {
    const bool in_memory = access("/dev/shm", W_OK) == 0;
    std::string name = in_memory ? "/dev/shm" : std::filesystem::temp_directory_path().string();
    name += "/stratalux-fuzz-XXXXXX";
    if (mkdtemp(name.data()) == nullptr) Fault("no folder for inputs");
    folder_ = name;
  }
  ~InputFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  InputFolder(const InputFolder&) = delete;
  InputFolder& operator=(const InputFolder&) = delete;

  // The file `name` with these bytes alone.
  std::filesystem::path Put(const std::string& name, std::span<const uint8_t> bytes) const {
    const std::filesystem::path file = folder_ / name;
    std::ofstream out(file, std::ios::binary | std::ios::trunc);
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    out.flush();
    if (!out) Fault("an input cannot be written");
    return file;
  }
  [[nodiscard]] const std::filesystem::path& path() const { return folder_; }

 private:
  std::filesystem::path folder_;
};

}  // namespace stratalux::fuzz

// SPDX-License-Identifier: Apache-2.0
// The fault layer for whole programs: LD_PRELOAD=libstore_faults.so with
//   STORE_FAULT="KIND AT EXTENT FOLDER": KIND nospace | syncerror | death | interruption, AT a number of calls, EXTENT
//   once | on.
// STORE_FAULT_COUNT=FILE: the number of calls at which it could have struck, added as a line when the program ends.
// Prints nothing; a program that cannot be armed must not seem to pass.
#include <cstdio>
#include <cstdlib>
#include <sstream>
#include <string>

#include "tests/db/crash/disk_recorder.h"

namespace stratalux::db::crash {
namespace {

[[gnu::constructor]] void Arm() {
  const char* text = std::getenv("STORE_FAULT");
  if (text == nullptr) return;
  std::string kind, extent, folder;
  DiskFault fault;
  std::istringstream in(text);
  if (!(in >> kind >> fault.at >> extent >> folder)) std::abort();
  fault.kind = kind == "nospace"        ? DiskFault::Kind::kNoSpace
               : kind == "syncerror"    ? DiskFault::Kind::kSyncError
               : kind == "interruption" ? DiskFault::Kind::kInterruption
                                        : DiskFault::Kind::kDeath;
  fault.extent = extent == "on" ? DiskFault::Extent::kFromThenOn : DiskFault::Extent::kOnce;
  StartRecording(folder, fault, StartImage::kUnread);
}

[[gnu::destructor]] void Count() {
  const char* file = std::getenv("STORE_FAULT_COUNT");
  if (file == nullptr) return;
  const int64_t calls = CallsThatCanFail(DiskFault::Kind::kDeath);
  (void)StopRecording();
  if (std::FILE* out = std::fopen(file, "a")) {
    std::fprintf(out, "%lld\n", static_cast<long long>(calls));
    std::fclose(out);
  }
}

}  // namespace
}  // namespace stratalux::db::crash

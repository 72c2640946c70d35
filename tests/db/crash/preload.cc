// SPDX-License-Identifier: Apache-2.0
// The fault layer for whole programs: LD_PRELOAD=libstore_faults.so with
//   STORE_FAULT="KIND AT EXTENT FOLDER": KIND nospace | syncerror | death, AT a number of calls, EXTENT once | on.
// Prints nothing; a program that cannot be armed must not seem to pass.
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
  fault.kind = kind == "nospace"     ? DiskFault::Kind::kNoSpace
               : kind == "syncerror" ? DiskFault::Kind::kSyncError
                                     : DiskFault::Kind::kDeath;
  fault.extent = extent == "on" ? DiskFault::Extent::kFromThenOn : DiskFault::Extent::kOnce;
  StartRecording(folder, fault);
}

}  // namespace
}  // namespace stratalux::db::crash

// SPDX-License-Identifier: Apache-2.0
// BoardWatch: looks at one pose's frames while they are captured and says at once whether the pose is worth keeping and
// what of the pictures the board covers. It finds no corners (that is the fitter's): it knows where the projectors'
// light comes back from and which column and row it has there.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/calibration/capture_fault.h"
#include "firmware-host/calibration/coverage.h"
#include "firmware-host/sequence/capture_observer.h"
#include "firmware-host/sequence/probe_lattice.h"

namespace stratalux::rig {

struct BoardSighting {
  CoverageMap camera;
  std::vector<CoverageMap> projectors;
  std::vector<CaptureFault> faults;
  std::vector<std::string> notes;  // of poses that are good all the same
};

struct BoardWatchOptions {
  int projectors = 4, projector_width = 1024, projector_height = 768;
  double saturation_dn = 4095.0;
  double exposure_ms = 16.0;
  double min_lit = 0.02;         // of the camera's picture: less is no board
  double max_saturated = 0.02;   // of what is lit
  double max_unreadable = 0.25;  // of what is lit: codes without contrast
  double max_moved = 0.03;       // of what is lit: pairs that do not add up to white
};

// Thread-bound. Frames may come in any order; a later shot of a step replaces an earlier one.
class BoardWatch : public CaptureObserver {
 public:
  explicit BoardWatch(const BoardWatchOptions& options) : options_(options) {}

  void OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) override;
  [[nodiscard]] std::vector<Finding> Objections() const override { return FindingsOf(Judge().faults); }
  [[nodiscard]] BoardSighting Judge() const;

 private:
  struct Lit;
  [[nodiscard]] const Probes* Find(int projector, const Pattern& pattern) const;
  [[nodiscard]] std::optional<Lit> LitBy(int projector) const;
  void JudgeProjector(int projector, const Lit& lit, BoardSighting& sighting) const;
  [[nodiscard]] double MovedShare(int projector, const Lit& lit) const;
  // Share of the lit probes whose codes cannot be read; covers the cells of the others.
  double CoverCells(int projector, const Lit& lit, CoverageMap& cells) const;

  BoardWatchOptions options_;
  ProbeLattice lattice_;
  std::map<std::pair<int, std::string>, Probes> frames_;  // by projector and pattern
};

}  // namespace stratalux::rig

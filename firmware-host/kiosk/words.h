// SPDX-License-Identifier: Apache-2.0
// The kiosk's vocabulary: what it may be in, why it is closed, what it says. Identifiers of a language file, no text.
#pragma once

#include <cstdint>
#include <initializer_list>

namespace stratalux::rig {

// What the visitor has before them. A visit goes from kQuestion to kThanks.
enum class Phase : uint8_t {
  kSafe,        // E-STOP, door or a fault of the light: dark until an operator resets it
  kClosed,      // for reasons of their own (Closure): nobody can begin
  kIdle,        // waits for a visitor
  kQuestion,    // are you sensitive to flashing light?
  kConsent,     // the text, its scopes; to refuse is as large as to agree
  kPosition,    // preview and pre-scans, until somebody sits right
  kCountdown,   // dark
  kCapture,     // patterns
  kGate,        // the capture is worth less than it could be: once more, or not
  kThanks,      // the ticket; withdrawing is possible
  kForgetting,  // what is on the disk of this visit goes
  kSelfcheck    // the operator has put a white card in
};
inline constexpr int kPhases = 12;

// Why nobody can begin. Several may hold at once.
enum class Closure : uint8_t {
  kHours,
  kSpace,        // no room for a visit's attempts
  kCalibration,  // none, or too old
  kCleaning,     // by the operator
  kOutOfOrder,   // by the operator
  kDevice,       // one is away, or not opened again yet
  kFault,        // two visits in a row, or a self-check, failed by the rig's doing
  kUnforgotten,  // what a visitor may have forgotten could not be removed
  kShutdown      // for good: the program ends
};
inline constexpr int kClosures = 9;

enum class Interlock : uint8_t { kEmergencyStop, kDoor };
enum class Device : uint8_t { kCamera, kLines };

// What a screen says beside what its phase says, or why something went as it did.
enum class Word : uint8_t {
  kNone,
  kNoFace,  // position
  kCloser,
  kBack,
  kCentre,
  kBrighter,  // the face returns too little light
  kHold,
  kMoved,  // gate
  kSaturated,
  kLamp,
  kCoverage,
  kProof,
  kMixedUp,
  kLight,  // safe: the light was taken away, or answers no more
  kEmergencyStop,
  kDoor,
  kStuck,  // something took longer than it may
  kDevice,
  kRefused,  // the end of a visit
  kLeft,
  kTimeOut,
  kSensitive,
  kGivenUp,
  kFault,
  kUnforgotten,
  kSelfcheckFailed,
  kClockJumped,
  kClosed,  // closed: Show's closures say why
  kShutdown,
  kLeftover,  // of what was forgotten; for the operator alone
  kDrift      // of a self-check's figures; for the operator alone
};
inline constexpr int kWords = 31;

// The one deadline that runs: of the phase that armed it.
enum class Deadline : uint8_t {
  kNone,
  kQuestion,
  kConsent,
  kPosition,
  kCountdown,  // a second
  kCapture,
  kGate,
  kThanks,
  kForgetting,
  kSelfcheck,
  kReopen  // until a camera that is there and did not open is tried again
};
inline constexpr int kDeadlines = 11;

enum class OperatorCommand : uint8_t { kClean, kOutOfOrder, kOpen, kSelfcheck, kReset };
inline constexpr int kOperatorCommands = 5;

// Keys of language files, of logs and of the store: "safe", "moved", "out_of_order".
[[nodiscard]] const char* ToString(Phase phase);
[[nodiscard]] const char* ToString(Closure closure);
[[nodiscard]] const char* ToString(Interlock interlock);
[[nodiscard]] const char* ToString(Device device);
[[nodiscard]] const char* ToString(Word word);
[[nodiscard]] const char* ToString(Deadline deadline);
[[nodiscard]] const char* ToString(OperatorCommand command);

// Values of a small enumeration, as a value.
template <typename E>
class EnumSet {
 public:
  constexpr EnumSet() = default;
  constexpr EnumSet(std::initializer_list<E> members) {
    for (const E member : members) Add(member);
  }
  constexpr void Add(E member) { bits_ |= Bit(member); }
  constexpr void Remove(E member) { bits_ &= ~Bit(member); }
  constexpr void Set(E member, bool in) { in ? Add(member) : Remove(member); }
  [[nodiscard]] constexpr bool Has(E member) const { return (bits_ & Bit(member)) != 0; }
  [[nodiscard]] constexpr bool empty() const { return bits_ == 0; }
  friend constexpr bool operator==(const EnumSet&, const EnumSet&) = default;

 private:
  static constexpr uint32_t Bit(E member) { return uint32_t{1} << static_cast<uint32_t>(member); }
  uint32_t bits_ = 0;
};

}  // namespace stratalux::rig

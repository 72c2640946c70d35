// SPDX-License-Identifier: Apache-2.0
// What `stratalux-rig COMMAND --help` shows below the flags.
#pragma once

namespace stratalux::rig {

inline constexpr const char* kExamples = R"(Examples:
  stratalux-rig capture --simulate --store store
  stratalux-rig selftest --simulate --store store
  stratalux-rig kiosk --config rig.toml --store store
  stratalux-rig devices
  stratalux-rig preview --simulate
  stratalux-rig plan show
  stratalux-rig safe

Each command's --help has examples of its own.)";
inline constexpr const char* kCaptureExamples = R"(Examples:
  stratalux-rig capture --simulate --store store
  stratalux-rig capture --simulate=head --store store --seed 7 --size 696x520 --json
  stratalux-rig capture --simulate=docs/examples/scenes/bearded.toml --store store
  stratalux-rig capture --simulate --store store --no-scattering
  stratalux-rig capture --simulate --store store --encrypt --visitor v-5f3a91c2 --consent-scope fit,research \
      --consent-text 2026-03 --consent-language de
  stratalux-rig capture --simulate --store store --fault frame_lost@17 --fault edge_lost@40x2
  stratalux-rig capture --simulate --store store --fault-rate 0.02 --fault-seed 5
  stratalux-rig capture --simulate --store store --on-start --simulate-events /tmp/rig &
      until [ -p /tmp/rig ]; do sleep 1; done; echo start > /tmp/rig
  stratalux-rig capture --kind calibration --simulate=docs/examples/scenes/charuco_poses.toml --store store
  stratalux-rig capture --kind calibration --store store
  stratalux-rig capture --kind calibration --pose 3 --store store
  stratalux-rig capture --kind flat --simulate --config rig.toml
  stratalux-rig capture --kind dark --store store
  stratalux-rig capture --config rig.toml --store store --calibration latest

Exit codes: 0 complete, 1 failed, 2 usage, 3 degraded, 5 store busy, 6 store damaged, 7 store of a newer version.)";
inline constexpr const char* kKioskExamples = R"(Examples:
  stratalux-rig kiosk --config rig.toml --store store
  printf 'start\nnot-sensitive\nrefuse\nstop\n' | stratalux-rig kiosk --simulate --store store
  stratalux-rig kiosk --simulate --size 696x520 --store store --simulate-events /tmp/rig &
      until [ -p /tmp/rig ]; do sleep 1; done; echo start > /tmp/rig
  stratalux-rig kiosk --simulate --store store --page

With --page or [kiosk.page] a browser shows the screens; its address is a line of JSON on stdout. Otherwise screens are
lines of JSON on stdout, and commands are lines on stdin: start, not-sensitive, sensitive, agree SCOPES LANGUAGE
[TEXT], refuse, leave, operator clean|out_of_order|open|selfcheck|reset, stop. SIGTERM ends it like stop: the
visit in progress is forgotten, all lights are off. Frames are encrypted unless [store] encrypt = false.
Exit codes: 0 ended, 1 the rig or the store failed, 2 usage, 3 a visit could not be forgotten, 5 a device is in use.)";
inline constexpr const char* kSelftestExamples = R"(Examples:
  stratalux-rig selftest --config rig.toml --store store
  stratalux-rig selftest --simulate --store store --json
  stratalux-rig selftest --trend --json | jq '.drifts'

Exit codes: 0 passed, 1 something failed (each item says what to do), 2 usage, 4 --trend: no self-check is kept,
5 a device is in use.)";
inline constexpr const char* kDevicesExamples = R"(Examples:
  stratalux-rig devices
  stratalux-rig devices --config rig.toml
  stratalux-rig devices --json | jq '.v4l2[].path'

Reserves, switches and changes nothing; a running rig is not disturbed. What cannot be opened is listed with the reason.
Exit codes: 0 the list was made, whatever is in it, 2 usage.)";
inline constexpr const char* kPreviewExamples = R"(Examples:
  stratalux-rig preview --config rig.toml
  stratalux-rig preview --config rig.toml --exposure 4 --port 8081
  stratalux-rig preview --simulate --size 696x520

The page's address is a line of JSON on stdout, on loopback; from another machine: ssh -L 8081:127.0.0.1:8081 RIG. It
shows the picture of the camera five times a second with level, saturation and sharpness, in the dark or under the white
of one projector. Nothing is stored. Ctrl-C or SIGTERM ends it, all lights off.
Exit codes: 0 ended, 1 the rig failed, 2 usage, 4 no such device, 5 a device or the port is in use.)";
inline constexpr const char* kPlanExamples = R"(Examples:
  stratalux-rig plan show
  stratalux-rig plan show --json --kind calibration
  stratalux-rig plan show --simulate=docs/examples/scenes/overlapped.toml
  stratalux-rig plan render --out patterns)";
inline constexpr const char* kSafeExamples = R"(Examples:
  stratalux-rig safe
  stratalux-rig safe --config rig.toml

Switches off the lights of the rig that was opened last ($STATE_DIRECTORY or /var/lib/stratalux, lights.json) and those
of the configuration, if it can be read. Run it as the account that captures.
Exit codes: 0 all lights are off, 1 a light could not be switched off, 2 neither names any light, 4 no such line or
display, 5 a running program holds a line or a display.)";

}  // namespace stratalux::rig

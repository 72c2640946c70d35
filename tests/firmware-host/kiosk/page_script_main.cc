// SPDX-License-Identifier: Apache-2.0
// kiosk_page_script: the kiosk's page over a scripted world, for tests/web/kiosk_page_test.py. Says where it serves as
// a line of JSON; then each line of standard input happens and is answered by a line, the machine's state:
//   EVENT (a name of visit_cases.cc) | open | progress DONE OF | box LEFT TOP RIGHT BOTTOM | preview FILE.png |
//   stop
#include <cstdio>
#include <cstring>
#include <iostream>
#include <sstream>
#include <thread>

#include "tests/firmware-host/kiosk/page_script.h"

namespace stratalux::rig {
namespace {

bool Obey(ScriptedKiosk& kiosk, const std::string& line) {
  std::istringstream words(line);
  std::string verb;
  words >> verb;
  if (verb == "open") {
    kiosk.Open();
    return true;
  }
  if (verb == "progress") {
    event::Progress progress;
    words >> progress.done >> progress.of;
    kiosk.Happen(VisitEvent(progress));
    return !words.fail();
  }
  if (verb == "box") {
    event::Face face{{}, 500, 1000, 16'000};
    words >> face.box.left >> face.box.top >> face.box.right >> face.box.bottom;
    kiosk.Happen(VisitEvent(face));
    return !words.fail();
  }
  std::string text;
  if (verb == "preview" && words >> text) {
    const auto frame = FrameOf(text);
    if (frame.ok()) kiosk.page().ShowPreview(frame->record, frame->pixels);
    return frame.ok();
  }
  return kiosk.Happen(verb);
}

int Run(const KioskPageOptions& options) {
  Logger logger(LogLevel::kWarning);
  auto kiosk = ScriptedKiosk::Start(options, logger);
  if (!kiosk.ok()) {
    std::cerr << kiosk.status().message() << "\n";
    return 1;
  }
  std::cout << R"({"url": ")" << (*kiosk)->page().url() << "\"}" << std::endl;
  const std::jthread turns([&kiosk](const std::stop_token& ends) {
    for (; !ends.stop_requested(); std::this_thread::sleep_for(std::chrono::milliseconds(500))) (*kiosk)->page().Beat();
  });
  for (std::string line; std::getline(std::cin, line) && line != "stop";) {
    (*kiosk)->page().Beat();
    const bool known = line.empty() || Obey(**kiosk, line);
    std::cout << (known ? ToString((*kiosk)->state()) : "what is '" + line + "'?") << std::endl;
  }
  return 0;
}

}  // namespace
}  // namespace stratalux::rig

// kiosk_page_script OPERATOR_TOKEN STORE [PORT]
int main(int argc, char** argv) {
  if (argc < 3) return 2;
  stratalux::rig::KioskPageOptions options;
  options.operator_token = argv[1];
  options.store = argv[2];
  options.opens = "09:30";
  if (argc > 3) options.port = std::stoi(argv[3]);
  return stratalux::rig::Run(options);
}

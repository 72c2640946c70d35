// SPDX-License-Identifier: Apache-2.0
// kiosk_page_script: the kiosk's page over a scripted world, for tests/web/kiosk_page_test.py. Says where it serves as
// a line of JSON; then each line of standard input happens and is answered by a line, the machine's state:
//   EVENT (a name of visit_cases.cc) | open | progress DONE OF | box LEFT TOP RIGHT BOTTOM | preview FILE.png |
//   selfchecks DAYS [FIGURE_OF_THE_LAST] (of four projectors; the light of the last day's, DN) | stop
#include <cmath>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <sstream>
#include <thread>

#include "tests/firmware-host/kiosk/page_script.h"

namespace stratalux::rig {
namespace {

// One a day until now, figures with a little noise.
bool ShowSelfchecks(KioskPage& page, std::istream& words) {
  int days = 0;
  double last = 0.0;
  if (!(words >> days)) return false;
  words >> last;
  SelfcheckBook book;
  for (int day = days - 1; day >= 0; --day) {
    const auto noise = [day](int p, double size) { return size * std::sin(1.7 * day + 2.1 * p); };
    Selfcheck check;
    check.at = {WallNow().ns - day * 24LL * 3600 * 1'000'000'000};
    check.passed = day != 3;
    for (int p = 0; p < 4; ++p) {
      check.Of(CheckFigure::kLevel).push_back(1900.0 + 60.0 * p + noise(p, 9.0));
      check.Of(CheckFigure::kDark).push_back(62.0 + noise(p, 0.4));
      check.Of(CheckFigure::kRedGreen).push_back(0.58 + noise(p, 0.002));
      check.Of(CheckFigure::kBlueGreen).push_back(0.81 + noise(p, 0.002));
      check.Of(CheckFigure::kEven).push_back(0.83 + noise(p, 0.004));
      check.Of(CheckFigure::kLit).push_back(0.92 + noise(p, 0.005));
      check.Of(CheckFigure::kSync).push_back(0.4 + noise(p, 0.02));
    }
    check.Of(CheckFigure::kFrameRate) = {28.0 + noise(0, 0.05)};
    if (day == 0 && last > 0.0) check.Of(CheckFigure::kLevel)[2] = last;
    book.Add(std::move(check));
  }
  page.ShowSelfchecks(TrendOf(book));
  return true;
}

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
  if (verb == "selfchecks") return ShowSelfchecks(kiosk.page(), words);
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

// kiosk_page_script OPERATOR_TOKEN STORE [PORT [STATE]]
int main(int argc, char** argv) {
  if (argc < 3) return 2;
  stratalux::rig::KioskPageOptions options;
  options.operator_token = argv[1];
  options.store = argv[2];
  options.opens = "09:30";
  if (argc > 3) options.port = std::stoi(argv[3]);
  if (argc > 4) options.state = argv[4];
  return stratalux::rig::Run(options);
}

// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/ticket_picture.h"

#include <cerrno>
#include <cstring>
#include <memory>

#include <qrencode.h>

namespace stratalux::rig {
namespace {

constexpr int kQuietModules = 4;

}  // namespace

Result<std::string> TicketPicture(const std::string& text) {
  if (text.empty()) return Status::Usage("a QR code needs a text");
  const std::unique_ptr<QRcode, decltype(&QRcode_free)> code(QRcode_encodeString8bit(text.c_str(), 0, QR_ECLEVEL_M),
                                                             QRcode_free);
  if (code == nullptr)
    return Status::Usage("no QR code holds these " + std::to_string(text.size()) +
                         " characters: " + std::strerror(errno));
  const std::string size = std::to_string(code->width + 2 * kQuietModules);
  std::string svg = R"(<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 )" + size + " " + size +
                    R"(" shape-rendering="crispEdges"><path fill="#fff" d="M0 0h)" + size + "v" + size +
                    "H0z\"/><path d=\"";
  for (int y = 0; y < code->width; ++y) {
    for (int x = 0; x < code->width;) {
      int end = x;
      while (end < code->width && (code->data[y * code->width + end] & 1) != 0) ++end;
      if (end > x)
        svg += "M" + std::to_string(x + kQuietModules) + " " + std::to_string(y + kQuietModules) + "h" +
               std::to_string(end - x) + "v1h-" + std::to_string(end - x) + "z";
      x = end + 1;
    }
  }
  return svg + "\"/></svg>\n";
}

}  // namespace stratalux::rig

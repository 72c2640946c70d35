// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/kms_display.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <utility>

#include <drm_fourcc.h>
#include <fcntl.h>
#include <poll.h>
#include <sys/mman.h>
#include <unistd.h>

#include "firmware-host/projector/display_picture.h"
#include "firmware-host/projector/kms_cards.h"
#include "firmware-host/projector/kms_handles.h"

namespace stratalux::rig {
namespace {

using std::chrono::steady_clock;

using kms::Connector;
using kms::Encoder;
using kms::Resources;

// What a flip that has happened left behind.
struct Flipped {
  int64_t vblank = 0;
  MonotonicNs time;
};

// An open graphics card, shared by its displays.
class Card {
 public:
  Card(int fd, std::string path) : fd_(fd), path_(std::move(path)) {}
  ~Card() { close(fd_); }
  Card(const Card&) = delete;
  Card& operator=(const Card&) = delete;

  [[nodiscard]] int fd() const { return fd_; }
  [[nodiscard]] const std::string& path() const { return path_; }
  std::mutex& mutex() { return mutex_; }
  std::set<uint32_t>& crtcs_in_use() { return crtcs_in_use_; }

  // errno of a refused request in words; what EACCES means here takes explaining.
  [[nodiscard]] Status Refused(const std::string& what, int error) const {
    if (error == EACCES || error == EPERM) {
      return Status::Failed(path_ + ": " + what +
                            " refused: another program took the screen (a desktop, a console switch);" +
                            " stop it and start again");
    }
    return Status::Failed(path_ + ": " + what + ": " + std::strerror(error));
  }
  // The flip of this CRTC, once it has happened, until `deadline`.
  Result<std::optional<Flipped>> TakeFlip(uint32_t crtc, steady_clock::time_point deadline);
  void ForgetFlip(uint32_t crtc) { flips_.erase(crtc); }

 private:
  static void OnFlip(int fd, unsigned vblank, unsigned s, unsigned us, unsigned crtc, void* card);

  int fd_;
  std::string path_;
  std::mutex mutex_;
  std::set<uint32_t> crtcs_in_use_;
  std::map<uint32_t, Flipped> flips_;  // by CRTC
};

void Card::OnFlip(int, unsigned vblank, unsigned s, unsigned us, unsigned crtc, void* card) {
  static_cast<Card*>(card)->flips_[crtc] = {.vblank = vblank, .time = {(int64_t{s} * 1000000 + us) * 1000}};
}

Result<std::optional<Flipped>> Card::TakeFlip(uint32_t crtc, steady_clock::time_point deadline) {
  // Waits without the lock, so that another thread can blank meanwhile; it looks again soon, since that thread may have
  // read this display's event along with its own.
  constexpr int64_t kLook_ms = 5;
  while (true) {
    {
      const std::lock_guard lock(mutex_);
      pollfd ready{fd_, POLLIN, 0};
      if (poll(&ready, 1, 0) > 0) {
        if ((ready.revents & (POLLERR | POLLHUP | POLLNVAL)) != 0) return Status::Failed(path_ + ": the card is gone");
        drmEventContext handlers{};
        handlers.version = 3;
        handlers.page_flip_handler2 = OnFlip;
        if (drmHandleEvent(fd_, &handlers) != 0) return Refused("reading flip events", errno);
      }
      if (const auto found = flips_.find(crtc); found != flips_.end()) {
        const Flipped flipped = found->second;
        flips_.erase(found);
        return std::optional<Flipped>(flipped);
      }
    }
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - steady_clock::now()).count();
    if (left <= 0) return std::optional<Flipped>();
    pollfd ready{fd_, POLLIN, 0};
    if (poll(&ready, 1, static_cast<int>(std::min<int64_t>(left, kLook_ms))) < 0 && errno != EINTR) {
      return Refused("waiting for flip events", errno);
    }
  }
}

// A picture the card can show, mapped for drawing; black at first.
class Buffer {
 public:
  static Result<std::unique_ptr<Buffer>> Create(const Card& card, int width, int height) {
    std::unique_ptr<Buffer> buffer(new Buffer(card.fd()));
    drm_mode_create_dumb& dumb = buffer->dumb_;
    dumb.width = static_cast<uint32_t>(width);
    dumb.height = static_cast<uint32_t>(height);
    dumb.bpp = 32;
    if (drmIoctl(card.fd(), DRM_IOCTL_MODE_CREATE_DUMB, &dumb) != 0) return card.Refused("making a picture", errno);
    const uint32_t handles[4] = {dumb.handle}, pitches[4] = {dumb.pitch}, offsets[4] = {};
    if (drmModeAddFB2(card.fd(), dumb.width, dumb.height, DRM_FORMAT_XRGB8888, handles, pitches, offsets, &buffer->id_,
                      0) != 0) {
      return card.Refused("making a picture of format XRGB8888", errno);
    }
    drm_mode_map_dumb map{};
    map.handle = dumb.handle;
    if (drmIoctl(card.fd(), DRM_IOCTL_MODE_MAP_DUMB, &map) != 0) return card.Refused("mapping a picture", errno);
    void* memory =
        mmap(nullptr, dumb.size, PROT_READ | PROT_WRITE, MAP_SHARED, card.fd(), static_cast<off_t>(map.offset));
    if (memory == MAP_FAILED) return card.Refused("mapping a picture", errno);
    buffer->memory_ = memory;
    std::memset(memory, 0, dumb.size);
    return buffer;
  }
  ~Buffer() {
    if (memory_ != nullptr) munmap(memory_, dumb_.size);
    if (id_ != 0) drmModeRmFB(fd_, id_);
    drm_mode_destroy_dumb destroy{};
    destroy.handle = dumb_.handle;
    if (dumb_.handle != 0) drmIoctl(fd_, DRM_IOCTL_MODE_DESTROY_DUMB, &destroy);
  }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;

  [[nodiscard]] uint32_t id() const { return id_; }
  // As wide as its rows are long in memory.
  [[nodiscard]] ImageView<uint32_t> pixels() const {
    return {static_cast<uint32_t*>(memory_), static_cast<int>(dumb_.pitch / 4), static_cast<int>(dumb_.height)};
  }

 private:
  explicit Buffer(int fd) : fd_(fd) {}

  int fd_;
  drm_mode_create_dumb dumb_{};
  uint32_t id_ = 0;
  void* memory_ = nullptr;
};

class KmsDisplay final : public Display, private LightSwitch {
 public:
  KmsDisplay(std::shared_ptr<Card> card, const DisplayWiring& wiring, uint32_t connector, uint32_t crtc,
             const drmModeModeInfo& mode)
      : card_(std::move(card)),
        wiring_(wiring),
        name_(card_->path() + " " + wiring.connector),
        connector_(connector),
        crtc_(crtc),
        mode_(mode) {}
  ~KmsDisplay() override {
    if (black_) static_cast<void>(Set(false));
    const std::lock_guard lock(card_->mutex());
    card_->crtcs_in_use().erase(crtc_);
    card_->ForgetFlip(crtc_);
  }
  KmsDisplay(const KmsDisplay&) = delete;
  KmsDisplay& operator=(const KmsDisplay&) = delete;

  Status Prepare() {
    for (std::unique_ptr<Buffer>* buffer : {&black_, &pictures_[0], &pictures_[1]}) {
      SLX_ASSIGN_OR_RETURN(*buffer, Buffer::Create(*card_, width(), height()));
    }
    const int error = Set(false);
    return error == 0 ? Status::Ok() : card_->Refused("black on " + wiring_.connector, error);
  }

  [[nodiscard]] int width() const override { return mode_.hdisplay; }
  [[nodiscard]] int height() const override { return mode_.vdisplay; }

  Status Load(const std::vector<Pattern>& sequence) override {
    for (const Pattern& pattern : sequence) SLX_RETURN_IF_ERROR(pattern.Validate(width(), height()));
    if (pending_) {
      SLX_ASSIGN_OR_RETURN(const std::optional<MonotonicNs> flipped, WaitFlip(std::chrono::seconds(1)));
      if (!flipped) return Status::Failed(name_ + ": a flip requested a second ago has not happened");
    }
    sequence_ = sequence;
    next_ = 0;
    return Status::Ok();
  }

  Status Flip() override {
    if (pending_) return Status::Failed(name_ + ": asked to flip while the flip before it has not happened");
    if (sequence_.empty()) return Status::Failed(name_ + ": asked to flip before any pattern was loaded");
    Buffer& back = *pictures_[back_];
    DrawPattern(sequence_[next_], wiring_.gamma, width(), back.pixels());
    const std::lock_guard lock(card_->mutex());
    uint64_t vblank = 0, ns = 0;
    asked_at_vblank_ = drmCrtcGetSequence(card_->fd(), crtc_, &vblank, &ns) == 0 ? static_cast<int64_t>(vblank) : -1;
    // Blanked in between, the guard reads the pattern on the screen and takes it away.
    const uint32_t shown = on_.load() ? back.id() : black_->id();
    if (drmModePageFlip(card_->fd(), crtc_, shown, DRM_MODE_PAGE_FLIP_EVENT, card_.get()) != 0) {
      return card_->Refused("flip of " + wiring_.connector, errno);
    }
    pending_ = true;
    back_ = 1 - back_;
    next_ = (next_ + 1) % sequence_.size();
    return Status::Ok();
  }

  Result<std::optional<MonotonicNs>> WaitFlip(std::chrono::nanoseconds timeout) override {
    if (!pending_) return std::optional<MonotonicNs>();
    SLX_ASSIGN_OR_RETURN(const std::optional<Flipped> flipped, card_->TakeFlip(crtc_, steady_clock::now() + timeout));
    if (!flipped) return std::optional<MonotonicNs>();
    pending_ = false;
    // The event counts vertical blanks modulo 2^32.
    if (asked_at_vblank_ >= 0) {
      const auto taken =
          static_cast<int32_t>(static_cast<uint32_t>(flipped->vblank) - static_cast<uint32_t>(asked_at_vblank_));
      skipped_vblanks_ += std::max(taken - 1, 0);
    }
    return std::optional<MonotonicNs>(flipped->time);
  }

  [[nodiscard]] LightSwitch& light() override { return *this; }

  [[nodiscard]] int64_t skipped_vblanks() const override { return skipped_vblanks_; }

 private:
  // LightSwitch: requests of the kernel on structs of the stack, without the card's lock; the kernel has its own.
  int Set(bool on) noexcept override {
    on_.store(on);
    if (on) return 0;
    return drmModeSetCrtc(card_->fd(), crtc_, black_->id(), 0, 0, &connector_, 1, &mode_) == 0 ? 0 : errno;
  }
  int Read(bool& on) noexcept override {
    drm_mode_crtc crtc{};
    crtc.crtc_id = crtc_;
    if (drmIoctl(card_->fd(), DRM_IOCTL_MODE_GETCRTC, &crtc) != 0) return errno;
    on = crtc.mode_valid != 0 && crtc.fb_id != 0 && crtc.fb_id != black_->id();
    return 0;
  }
  [[nodiscard]] bool may_wait() const noexcept override { return true; }
  [[nodiscard]] const char* name() const noexcept override { return name_.c_str(); }

  std::shared_ptr<Card> card_;
  DisplayWiring wiring_;
  std::string name_;
  uint32_t connector_;
  uint32_t crtc_;
  drmModeModeInfo mode_;
  std::unique_ptr<Buffer> black_;
  std::unique_ptr<Buffer> pictures_[2];  // one on the screen, one to draw on
  int back_ = 0;
  std::vector<Pattern> sequence_;
  size_t next_ = 0;
  bool pending_ = false;
  int64_t asked_at_vblank_ = -1;
  int64_t skipped_vblanks_ = 0;
  std::atomic<bool> on_ = false;  // as the guard wants it
};

Result<std::shared_ptr<Card>> OpenCard(const std::string& path) {
  const int fd = open(path.c_str(), O_RDWR | O_CLOEXEC);
  if (fd < 0) {
    const std::string why = path + ": " + std::strerror(errno);
    if (errno == EACCES) return Status::Failed(why + "; the user must be in the group video");
    return Status::NotFound(why);
  }
  auto card = std::make_shared<Card>(fd, path);
  uint64_t dumb = 0, monotonic = 0;
  if (drmGetCap(fd, DRM_CAP_DUMB_BUFFER, &dumb) != 0 || dumb == 0) {
    return Status::NotFound(path + ": this card shows no plain pictures (no dumb buffers)");
  }
  if (drmGetCap(fd, DRM_CAP_TIMESTAMP_MONOTONIC, &monotonic) != 0 || monotonic == 0) {
    return Status::NotFound(path + ": this card's driver does not stamp flips with CLOCK_MONOTONIC");
  }
  return card;
}

// The connector's id on this card; 0: it has none of that name.
uint32_t FindConnector(const Card& card, const std::string& name) {
  const Resources resources(drmModeGetResources(card.fd()));
  for (int i = 0; resources && i < resources->count_connectors; ++i) {
    const Connector connector(drmModeGetConnectorCurrent(card.fd(), resources->connectors[i]));
    if (!connector) continue;
    if (KmsConnectorName(connector->connector_type, connector->connector_type_id) == name)
      return connector->connector_id;
  }
  return 0;
}

// The card of the display, opened or found among `cards`.
Result<std::shared_ptr<Card>> CardOf(const DisplayWiring& wiring, std::map<std::string, std::shared_ptr<Card>>& cards) {
  std::vector<std::string> paths;
  if (wiring.device.empty()) {
    paths = KmsPaths();
  } else {
    std::error_code error;
    const std::filesystem::path resolved = std::filesystem::canonical(wiring.device, error);
    if (error) return Status::NotFound(wiring.device + ": " + error.message());
    paths = {resolved.string()};
  }
  std::string refusals;
  for (const std::string& path : paths) {
    std::shared_ptr<Card>& card = cards[path];
    if (!card) {
      Result<std::shared_ptr<Card>> opened = OpenCard(path);
      if (!opened.ok()) {
        refusals += "; " + opened.status().message();
        continue;
      }
      card = *opened;
    }
    if (FindConnector(*card, wiring.connector) != 0) return card;
  }
  const std::string where = wiring.device.empty() ? "any graphics card of /dev/dri" : wiring.device;
  return Status::NotFound("no connector " + wiring.connector + " on " + where + refusals +
                          "; `stratalux-rig devices` lists the connectors");
}

// A CRTC that can feed the connector and feeds no other display of ours; the one it has now, if possible.
Result<uint32_t> FreeCrtc(const Card& card, const drmModeConnector& connector, const std::set<uint32_t>& in_use) {
  const Resources resources(drmModeGetResources(card.fd()));
  if (!resources) return card.Refused("listing resources", errno);
  std::optional<uint32_t> any;
  for (int e = 0; e < connector.count_encoders; ++e) {
    const Encoder encoder(drmModeGetEncoder(card.fd(), connector.encoders[e]));
    if (!encoder) continue;
    for (int c = 0; c < resources->count_crtcs; ++c) {
      const uint32_t crtc = resources->crtcs[c];
      if ((encoder->possible_crtcs & (1U << c)) == 0 || in_use.contains(crtc)) continue;
      if (crtc == encoder->crtc_id) return crtc;
      if (!any) any = crtc;
    }
  }
  if (!any) return Status::Usage(card.path() + ": the card cannot feed so many displays at once");
  return *any;
}

double RefreshHz(const drmModeModeInfo& mode) {
  return mode.clock * 1000.0 / (static_cast<double>(mode.htotal) * mode.vtotal);
}

Result<drmModeModeInfo> ModeOf(const drmModeConnector& connector, const DisplayWiring& wiring) {
  std::vector<DisplayMode> modes;
  std::string names;
  for (int i = 0; i < connector.count_modes; ++i) {
    const drmModeModeInfo& mode = connector.modes[i];
    const bool interlaced = (mode.flags & DRM_MODE_FLAG_INTERLACE) != 0;  // half a pattern at a time: never picked
    modes.push_back({.width = interlaced ? 0 : mode.hdisplay, .height = mode.vdisplay, .refresh_hz = RefreshHz(mode)});
    if (!interlaced) names += " " + std::string(mode.name) + "@" + std::to_string(mode.vrefresh);
  }
  const std::optional<size_t> picked = PickMode(modes, wiring.width, wiring.height, wiring.refresh_hz);
  if (!picked) {
    return Status::Usage(wiring.connector + " has no mode " + std::to_string(wiring.width) + "x" +
                         std::to_string(wiring.height) +
                         (wiring.refresh_hz > 0 ? "@" + std::to_string(wiring.refresh_hz) : "") + "; it has:" + names);
  }
  return connector.modes[*picked];
}

Result<std::unique_ptr<Display>> OpenDisplay(const std::shared_ptr<Card>& card, const DisplayWiring& wiring) {
  const Connector connector(drmModeGetConnector(card->fd(), FindConnector(*card, wiring.connector)));
  if (!connector) return card->Refused("asking for connector " + wiring.connector, errno);
  if (connector->connection != DRM_MODE_CONNECTED) {
    return Status::NotFound(card->path() + ": nothing is plugged into " + wiring.connector + ", or it is switched off");
  }
  if (drmIsMaster(card->fd()) == 0 && drmSetMaster(card->fd()) != 0) {
    return Status::Busy(card->path() +
                        ": another program shows its pictures on this card; stop the desktop (systemctl" +
                        " isolate multi-user.target)");
  }
  SLX_ASSIGN_OR_RETURN(const drmModeModeInfo mode, ModeOf(*connector, wiring));
  SLX_ASSIGN_OR_RETURN(const uint32_t crtc, FreeCrtc(*card, *connector, card->crtcs_in_use()));
  auto display = std::make_unique<KmsDisplay>(card, wiring, connector->connector_id, crtc, mode);
  card->crtcs_in_use().insert(crtc);
  SLX_RETURN_IF_ERROR(display->Prepare());
  return std::unique_ptr<Display>(std::move(display));
}

}  // namespace

Result<std::vector<std::unique_ptr<Display>>> OpenKmsDisplays(const std::vector<DisplayWiring>& wirings) {
  std::map<std::string, std::shared_ptr<Card>> cards;
  std::vector<std::unique_ptr<Display>> displays;
  for (const DisplayWiring& wiring : wirings) {
    SLX_ASSIGN_OR_RETURN(const std::shared_ptr<Card> card, CardOf(wiring, cards));
    SLX_ASSIGN_OR_RETURN(std::unique_ptr<Display> display, OpenDisplay(card, wiring));
    displays.push_back(std::move(display));
  }
  return displays;
}

Status BlankDisplay(const DisplayWiring& wiring) {
  std::map<std::string, std::shared_ptr<Card>> cards;
  SLX_ASSIGN_OR_RETURN(const std::shared_ptr<Card> card, CardOf(wiring, cards));
  if (drmIsMaster(card->fd()) == 0 && drmSetMaster(card->fd()) != 0)
    return Status::Busy(card->path() + ": " + wiring.connector + " is driven by " + UsersOfCard(card->path()) +
                        "; end that program, and its picture goes with it");
  const Connector connector(drmModeGetConnectorCurrent(card->fd(), FindConnector(*card, wiring.connector)));
  const Encoder encoder(connector ? drmModeGetEncoder(card->fd(), connector->encoder_id) : nullptr);
  if (!encoder || encoder->crtc_id == 0) return Status::Ok();  // nothing feeds it
  if (drmModeSetCrtc(card->fd(), encoder->crtc_id, 0, 0, 0, nullptr, 0, nullptr) != 0)
    return card->Refused("switching off " + wiring.connector, errno);
  return Status::Ok();
}

}  // namespace stratalux::rig

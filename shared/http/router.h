// SPDX-License-Identifier: Apache-2.0
// Which handler answers what: by method and pattern of the path.
#pragma once

#include <string>
#include <vector>

#include "shared/http/access.h"
#include "shared/http/message.h"
#include "shared/http/target.h"

namespace stratalux::http {

// Filled before the server starts, then only read.
class Router {
 public:
  // A pattern is segments: as they are, "{name}" for any one, and as the last "{name...}" for one or more, joined by
  // slashes. Of two that fit the first one added answers. A GET route answers HEAD, too.
  void Add(Method method, const std::string& pattern, Handler handler, Audience audience = Audience::kHoldersOfToken);

  struct Match {
    const Handler* handler = nullptr;  // null: nothing has this path, or not with this method
    Audience audience = Audience::kHoldersOfToken;
    std::vector<Method> allowed;                   // with which the path can be asked; none: nothing has it
    std::map<std::string, std::string> wildcards;  // of the handler's pattern
  };
  [[nodiscard]] Match Find(Method method, const Target& target) const;

 private:
  struct Route {
    Method method;
    std::vector<std::string> pattern;
    Handler handler;
    Audience audience;
  };
  std::vector<Route> routes_;
};

}  // namespace stratalux::http

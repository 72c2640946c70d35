// SPDX-License-Identifier: Apache-2.0
// What the guest's shell cannot do to a process.
//   rig-vm-process run PROGRAM [ARGUMENT]...   as a terminal starts it: a shell's background ignores INT and QUIT
//   rig-vm-process limit PID KIND              memory: it gets no more than it has (RLIMIT_AS)
//                                              file:   no file may grow (RLIMIT_FSIZE)
//                                              cpu:    a second of processor time in all (RLIMIT_CPU)
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include <sys/resource.h>
#include <unistd.h>

namespace {

int Fail(const std::string& what) {
  std::perror(("rig-vm-process: " + what).c_str());
  return 1;
}

int Run(char** command) {
  for (const int signal : {SIGINT, SIGQUIT}) std::signal(signal, SIG_DFL);
  execvp(command[0], command);
  return Fail(command[0]);
}

int Limit(const std::string& pid, const std::string& kind) {
  rlimit limit{1, RLIM_INFINITY};
  int resource = kind == "file" ? RLIMIT_FSIZE : RLIMIT_CPU;
  if (kind == "memory") {
    resource = RLIMIT_AS;
    unsigned long pages = 0;
    if (!(std::ifstream("/proc/" + pid + "/statm") >> pages)) return Fail("no process " + pid);
    limit.rlim_cur = pages * static_cast<unsigned long>(sysconf(_SC_PAGESIZE));
  }
  return prlimit(std::stoi(pid), static_cast<__rlimit_resource>(resource), &limit, nullptr) == 0 ? 0 : Fail("prlimit");
}

}  // namespace

int main(int argc, char** argv) {
  const std::string verb = argc > 2 ? argv[1] : "";
  if (verb == "run") return Run(argv + 2);
  if (verb == "limit" && argc == 4) return Limit(argv[2], argv[3]);
  std::fputs("usage: rig-vm-process run PROGRAM [ARGUMENT]... | limit PID memory|file|cpu\n", stderr);
  return 2;
}

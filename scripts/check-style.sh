#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#   scripts/check-style.sh format [ROOT]   clang-format would change nothing
#   scripts/check-style.sh spdx [ROOT]     every source file begins with its licence
#   scripts/check-style.sh scratch [ROOT]  nothing has a fixed name in the temporary folder, where
#                                          two tests at once would take each other's files
set -uo pipefail
cd "${2:-$(dirname "$0")/..}" || exit 2
export LC_ALL=C
sources() { find shared db firmware-host fitter tests -name '*.h' -o -name '*.cc' | sort; }
case "${1:-}" in
  format) sources | xargs clang-format --dry-run -Werror ;;
  spdx)
    begun() { sources | xargs awk 'FNR == 1 && /SPDX-License-Identifier: Apache-2.0/ {print FILENAME}'; }
    missing=$(comm -23 <(sources) <(begun))
    [ -n "$missing" ] || exit 0
    sed 's/$/: no SPDX line/' <<<"$missing"
    exit 1 ;;
  scratch)
    fixed=$(sources | xargs grep -lPzo 'testing::TempDir\(\)|(temp_directory_path|TemporaryFolder)\(\)\s*/(?![^;]*(XXXXXX|getpid\(\)))')
    [ -n "$fixed" ] || exit 0
    while read -r file; do
      echo "$file: a fixed name in the temporary folder; tests/support/scratch_folder.h has folders"
    done <<<"$fixed"
    exit 1 ;;
  *) echo "usage: scripts/check-style.sh format|spdx|scratch [ROOT]" >&2; exit 2 ;;
esac

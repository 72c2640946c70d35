#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The style check must find a planted violation in every folder, and pass a clean tree.
#   scripts/check-style-selftest.sh format|spdx|scratch
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
check=$here/check-style.sh
kind=${1:?format, spdx or scratch}
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
spdx='// SPDX-License-Identifier: Apache-2.0'
fresh() {
  rm -rf "${tree:?}"/*
  mkdir -p "$tree"/{shared,db,firmware-host,fitter,tests}/a
  cp "$here/../.clang-format" "$tree"
  printf '%s\n#pragma once\n\nint Clean(int a);\n' "$spdx" >"$tree/shared/a/clean.h"
}
plant() {   # FILE TEXT
  fresh
  printf '%b' "$2" >"$tree/$1"
  if "$check" "$kind" "$tree" >"$tree/log" 2>&1; then echo "$kind: not found in $1: $2"; exit 1; fi
  grep -q "$1" "$tree/log" || { echo "$kind: $1 is not named"; cat "$tree/log"; exit 1; }
}
fresh
"$check" "$kind" "$tree" || { echo "a clean tree was refused"; exit 1; }
for folder in shared db firmware-host fitter tests; do
  for file in "$folder/a/bad.cc" "$folder/a/bad.h"; do
    case $kind in
      format)
        plant "$file" "$spdx\nint  Spaced( int a );\n"
        plant "$file" "$spdx\nint f(int a) {\n      return a;\n}\n"
        plant "$file" "$spdx\nint AVeryLongName(int first_argument, int second_argument, int third_argument, int fourth_argument, int fifth_argument, int sixth_argument);\n" ;;
      spdx)
        plant "$file" "int x;\n"
        plant "$file" ""
        plant "$file" "\n$spdx\nint x;\n"                           # on the first line, not on a later one
        plant "$file" "// SPDX-License-Identifier: MIT\nint x;\n" ;;
      scratch)
        plant "$file" "$spdx\nauto f = std::filesystem::temp_directory_path() / \"mesh.ply\";\n"
        plant "$file" "$spdx\nauto f =\n    fs::temp_directory_path() /\n    (name + \".ply\");\n"
        plant "$file" "$spdx\nauto f = TemporaryFolder() / (\"mesh.\" + name);\n"
        plant "$file" "$spdx\nauto f = ::testing::TempDir() + \"mesh.ply\";\n" ;;
    esac
  done
done

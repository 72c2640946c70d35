# SPDX-License-Identifier: Apache-2.0
# Style checks as tests.
find_program(CLANG_FORMAT_PROGRAM clang-format)
add_test(NAME style.includes COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-includes.sh")
add_test(NAME style.includes_selftest COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-includes-selftest.sh")
add_test(NAME style.spdx COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style.sh" spdx)
add_test(NAME style.spdx_selftest COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style-selftest.sh" spdx)
set(style_tests style.includes style.includes_selftest style.spdx style.spdx_selftest)
if(CLANG_FORMAT_PROGRAM)
  add_test(NAME style.format COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style.sh" format)
  add_test(NAME style.format_selftest COMMAND "${CMAKE_SOURCE_DIR}/scripts/check-style-selftest.sh" format)
  list(APPEND style_tests style.format style.format_selftest)
endif()
set_tests_properties(${style_tests} PROPERTIES LABELS style)

# SPDX-License-Identifier: Apache-2.0
# Read by cpack before it packages: what is known only then.
if(NOT CPACK_STRATALUX_REVISION)
  set(CPACK_STRATALUX_REVISION 1)
endif()
if(NOT CPACK_STRATALUX_DATE)
  set(CPACK_STRATALUX_DATE "Thu, 01 Jan 1970 00:00:00 +0000")
endif()
if(CPACK_STRATALUX_MAINTAINER)
  set(CPACK_DEBIAN_PACKAGE_MAINTAINER "${CPACK_STRATALUX_MAINTAINER}")
endif()
set(CPACK_DEBIAN_PACKAGE_RELEASE "${CPACK_STRATALUX_REVISION}")
# Of one build: tables and account belong to the programs.
foreach(package DB RIG FIT)
  set(CPACK_DEBIAN_STRATALUX-${package}_PACKAGE_DEPENDS "stratalux-data (= ${CPACK_PACKAGE_VERSION}-${CPACK_STRATALUX_REVISION})")
endforeach()

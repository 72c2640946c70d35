# SPDX-License-Identifier: Apache-2.0
# Between the staged files and the packages: changelogs are written, they and manual pages compressed as Debian has them,
# without names and times, so that the same sources give the same bytes.
foreach(package IN LISTS CPACK_COMPONENTS_ALL)
  set(changelog "${CPACK_TEMPORARY_DIRECTORY}/${package}/usr/share/doc/${package}/changelog.Debian")
  file(WRITE "${changelog}"
"stratalux (${CPACK_PACKAGE_VERSION}-${CPACK_STRATALUX_REVISION}) unstable; urgency=medium

  * What is new: /usr/share/doc/stratalux/CHANGELOG.md of stratalux-data.

 -- ${CPACK_DEBIAN_PACKAGE_MAINTAINER}  ${CPACK_STRATALUX_DATE}
")
  file(CHMOD "${changelog}" PERMISSIONS OWNER_READ OWNER_WRITE GROUP_READ WORLD_READ)
  file(GLOB pages "${CPACK_TEMPORARY_DIRECTORY}/${package}/usr/share/man/man1/*.1")
  foreach(file IN LISTS changelog pages)
    execute_process(COMMAND gzip -9nf "${file}" COMMAND_ERROR_IS_FATAL ANY)
  endforeach()
endforeach()
if(DEFINED ENV{SOURCE_DATE_EPOCH})
  execute_process(COMMAND find "${CPACK_TEMPORARY_DIRECTORY}" -exec touch --no-dereference --date=@$ENV{SOURCE_DATE_EPOCH} {} +
                  COMMAND_ERROR_IS_FATAL ANY)
endif()

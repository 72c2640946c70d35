# SPDX-License-Identifier: Apache-2.0
# Debian packages by `cpack` (scripts/package.sh). A package is what `install(... COMPONENT its name)` says; who depends on
# which library is dpkg-shlibdeps' to find.
# scripts/package.sh says more by `cpack -D`: CPACK_STRATALUX_REVISION, _MAINTAINER, _DATE (packaging/options.cmake).
set(STRATALUX_PACKAGES stratalux-data stratalux-db stratalux-rig)
if(STRATALUX_BUILD_FITTER)
  list(APPEND STRATALUX_PACKAGES stratalux-fit)
endif()
set(packaging "${CMAKE_SOURCE_DIR}/packaging")

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME stratalux)
set(CPACK_COMPONENTS_ALL ${STRATALUX_PACKAGES})
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_PROJECT_CONFIG_FILE "${packaging}/options.cmake")
set(CPACK_PRE_BUILD_SCRIPTS "${packaging}/finish.cmake")
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_MAINTAINER "Stratalux maintainers <root@localhost>")
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)

# stratalux_package(NAME SUMMARY text DESCRIPTION text [DEPENDS ...] [RECOMMENDS ...] [SUGGESTS ...]): what is said of a package. Maintainer
# scripts and the list of its configuration files lie in packaging/NAME/.
macro(stratalux_package name)
  cmake_parse_arguments(ARG "" "SUMMARY;DESCRIPTION;DEPENDS;RECOMMENDS;SUGGESTS" "" ${ARGN})
  string(TOUPPER "${name}" key)
  set(CPACK_DEBIAN_${key}_PACKAGE_NAME "${name}")
  set(CPACK_DEBIAN_${key}_DESCRIPTION "${ARG_SUMMARY}\n${ARG_DESCRIPTION}")
  set(CPACK_DEBIAN_${key}_PACKAGE_DEPENDS "${ARG_DEPENDS}")
  set(CPACK_DEBIAN_${key}_PACKAGE_RECOMMENDS "${ARG_RECOMMENDS}")
  set(CPACK_DEBIAN_${key}_PACKAGE_SUGGESTS "${ARG_SUGGESTS}")
  set(CPACK_DEBIAN_${key}_PACKAGE_SHLIBDEPS ON)
  file(GLOB scripts "${packaging}/${name}/p*" "${packaging}/${name}/conffiles")
  set(CPACK_DEBIAN_${key}_PACKAGE_CONTROL_EXTRA "${scripts}")
  install(FILES "${packaging}/copyright" DESTINATION share/doc/${name} COMPONENT ${name} EXCLUDE_FROM_ALL)
  if(EXISTS "${packaging}/${name}/lintian-overrides")
    install(FILES "${packaging}/${name}/lintian-overrides" DESTINATION share/lintian/overrides RENAME ${name} COMPONENT ${name} EXCLUDE_FROM_ALL)
  endif()
endmacro()

stratalux_package(stratalux-data
  SUMMARY "tables, account and documents of Stratalux"
  DESCRIPTION "Stratalux measures how light travels under a person's skin and puts it
back on screen. This package holds the simulated skin's light-transport
tables, the documents, the configuration, and the account that owns the
store and opens a rig's devices."
  DEPENDS "systemd | systemd-standalone-sysusers | systemd-sysusers, systemd | systemd-standalone-tmpfiles | systemd-tmpfiles")
set(CPACK_DEBIAN_STRATALUX-DATA_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_STRATALUX-DATA_PACKAGE_SHLIBDEPS OFF)
stratalux_package(stratalux-db
  SUMMARY "session store of Stratalux: list, verify, back up, forget"
  DESCRIPTION "Stratalux measures how light travels under a person's skin and puts it
back on screen. This program lists, shows and verifies the sessions of a
store, also in a browser, copies them between machines and forgets visitors
whose time is over; timers do the latter every night."
  RECOMMENDS "rsync, openssh-client")
stratalux_package(stratalux-rig
  SUMMARY "controller of a Stratalux rig: projectors, camera, proof of each frame"
  DESCRIPTION "Stratalux measures how light travels under a person's skin and puts it
back on screen. This program runs on the rig's computer: it steps the
projectors, grabs the camera's frames, proves which frame shows which
pattern and writes them to the store. A simulated rig stands in where there
is none."
  RECOMMENDS "stratalux-db"
  SUGGESTS "cage, xwayland, chromium")
if(STRATALUX_BUILD_FITTER)
  stratalux_package(stratalux-fit
    SUMMARY "fits scattering layers of skin to sessions of Stratalux"
    DESCRIPTION "Stratalux measures how light travels under a person's skin and puts it
back on screen. This program reconstructs the face from a session of a
store, separates light reflected by the surface from light that wandered
through the skin, fits twenty scattering layers to every pixel and renders
the face under new light."
      RECOMMENDS "stratalux-db")
endif()

# The configuration, a conffile: the rig's, and on a workstation the days that a purge goes by. `cmake --install` without packages leaves that of a machine alone.
file(READ "${CMAKE_SOURCE_DIR}/docs/examples/rig.toml" text)
string(REPLACE "\n# store = \"/var/lib/stratalux/store\"" "\nstore = \"/var/lib/stratalux/store\"" text "${text}")
file(WRITE "${CMAKE_BINARY_DIR}/packaging/rig.toml" "${text}")
install(FILES "${CMAKE_BINARY_DIR}/packaging/rig.toml" DESTINATION /etc/stratalux COMPONENT stratalux-data EXCLUDE_FROM_ALL)
include(CPack)

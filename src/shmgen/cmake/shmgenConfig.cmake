# find_package(shmgen) defines shmgen_generate(), which generates code when the project is built.
#
#   shmgen_generate(<target>
#     [CONFIG <shmgen.toml>]       default: shmgen.toml beside CMakeLists.txt
#     [INCLUDE <folder>...]        folders of message packages, with precedence over all others
#     [OUTPUT <folder>]            default: <build folder>/<target>
#     [TARGETS <target>...]        shmgen's targets, such as c and cpp; default: `targets` in shmgen.toml
#     [MESSAGES <type|package>...] default: `messages` in shmgen.toml
#     [LINK <folder>...]           folders with an installed layout.lock: files of its messages are not generated again, so
#                                  link their target too
#     [OPTIONAL]                   leave out messages without a bound; if none is left, warn and define no <target>
#     [HEADERS <folder>]           folder for installed headers; default: include
#     [INSTALL])                   install headers, and into share/<project>/shmgen Python, Structured Text and layout.lock
#
# <target> is an INTERFACE library with the headers in OUTPUT/c, cpp, cpp_ros1 and cpp_ros2, and the system libraries that
# they need. Python code is in OUTPUT/python. The build generates again if shmgen.toml, a definition that was read or its
# package.xml changes, or if a definition is added below the folder of shmgen.toml or an INCLUDE folder.
#
#   shmgen_library(<target> [INSTALL])
#
# builds the functions of the C headers for programs in other languages, as libshmgen.so and libshmgen.a (the targets
# shmgen_shared and shmgen_static). Call it after shmgen_generate(<target>). INSTALL also installs shmgen.pc for pkg-config.
cmake_minimum_required(VERSION 3.20)

find_program(SHMGEN_EXECUTABLE shmgen HINTS "${CMAKE_CURRENT_LIST_DIR}/../../../bin")
if(NOT SHMGEN_EXECUTABLE)
  set(shmgen_FOUND FALSE)
  set(shmgen_NOT_FOUND_MESSAGE "the program shmgen is not in PATH: install it with pip, and activate its environment")
  return()
endif()

function(shmgen_generate target)
  cmake_parse_arguments(PARSE_ARGV 1 ARG "INSTALL;OPTIONAL" "CONFIG;OUTPUT;HEADERS" "INCLUDE;TARGETS;MESSAGES;LINK")
  if(ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "shmgen_generate(${target}): unknown arguments: ${ARG_UNPARSED_ARGUMENTS}")
  endif()
  if(NOT ARG_CONFIG)
    set(ARG_CONFIG shmgen.toml)
  endif()
  if(NOT ARG_OUTPUT)
    set(ARG_OUTPUT "${CMAKE_CURRENT_BINARY_DIR}/${target}")
  endif()
  if(NOT ARG_HEADERS)
    set(ARG_HEADERS include)
  endif()
  get_filename_component(config "${ARG_CONFIG}" ABSOLUTE)
  get_filename_component(home "${config}" DIRECTORY)
  set(options "")
  set(definitions "")
  foreach(folder IN LISTS ARG_INCLUDE ITEMS "${home}")
    get_filename_component(folder "${folder}" ABSOLUTE)
    file(GLOB_RECURSE found CONFIGURE_DEPENDS
      "${folder}/*.msg" "${folder}/*.srv" "${folder}/*.action" "${folder}/*.idl")
    list(APPEND definitions ${found})
    if(NOT folder STREQUAL home)
      list(APPEND options -I "${folder}")
    endif()
  endforeach()
  foreach(language IN LISTS ARG_TARGETS)
    list(APPEND options -t "${language}")
  endforeach()
  if(ARG_MESSAGES)
    list(APPEND options --only ${ARG_MESSAGES})
  endif()
  foreach(folder IN LISTS ARG_LINK)
    list(APPEND options --link "${folder}")
  endforeach()
  if(ARG_OPTIONAL)
    list(APPEND options --skip-unbounded)
  endif()
  set(stamp "${CMAKE_CURRENT_BINARY_DIR}/${target}.stamp")
  set(headers "${ARG_OUTPUT}/c" "${ARG_OUTPUT}/cpp" "${ARG_OUTPUT}/cpp_ros1" "${ARG_OUTPUT}/cpp_ros2")
  set(generate "${SHMGEN_EXECUTABLE}" generate --config "${config}" --output "${ARG_OUTPUT}" ${options})
  # Ninja recompiles only for changed headers that are listed as byproducts. The build reports errors of this run.
  execute_process(COMMAND ${generate} OUTPUT_VARIABLE output ERROR_VARIABLE error RESULT_VARIABLE failed)
  if(ARG_OPTIONAL AND failed)
    message(WARNING "shmgen generates no code for ${ARG_MESSAGES}:\n${error}")
    return()
  elseif(output MATCHES "[0-9]+ messages? left out.*")
    message(STATUS "shmgen: ${CMAKE_MATCH_0}")
  endif()
  list(TRANSFORM headers APPEND "/*.h*" OUTPUT_VARIABLE patterns)
  file(GLOB_RECURSE existing_headers ${patterns})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS "${config}")
  add_custom_command(
    OUTPUT "${stamp}"
    BYPRODUCTS ${existing_headers}
    COMMAND ${generate} --quiet --depfile "${stamp}.d"
    COMMAND "${CMAKE_COMMAND}" -E touch "${stamp}"
    DEPENDS "${config}" ${definitions}
    DEPFILE "${stamp}.d"
    COMMENT "shmgen generate ${target}"
    VERBATIM)
  add_custom_target(${target}_files ALL DEPENDS "${stamp}")
  add_library(${target} INTERFACE)
  set_target_properties(${target} PROPERTIES SHMGEN_HEADERS "${ARG_OUTPUT}/c" SHMGEN_INSTALLED "${ARG_HEADERS}")
  add_dependencies(${target} ${target}_files)
  target_include_directories(${target} SYSTEM INTERFACE
    "$<BUILD_INTERFACE:${headers}>" "$<INSTALL_INTERFACE:${ARG_HEADERS}>")
  if(UNIX)
    target_link_libraries(${target} INTERFACE pthread rt)  # part of the C library since glibc 2.34
  endif()
  if(ARG_INSTALL)
    foreach(folder IN LISTS headers)
      install(DIRECTORY "${folder}/" DESTINATION "${ARG_HEADERS}" OPTIONAL)
    endforeach()
    install(DIRECTORY "${ARG_OUTPUT}/python" "${ARG_OUTPUT}/st" "${ARG_OUTPUT}/plcopen"
      DESTINATION "share/${PROJECT_NAME}/shmgen" OPTIONAL PATTERN __pycache__ EXCLUDE)
    install(FILES "${ARG_OUTPUT}/layout.lock" DESTINATION "share/${PROJECT_NAME}/shmgen")
  endif()
endfunction()

function(shmgen_library target)
  cmake_parse_arguments(PARSE_ARGV 1 ARG "INSTALL" "" "")
  get_target_property(headers ${target} SHMGEN_HEADERS)
  get_target_property(installed ${target} SHMGEN_INSTALLED)
  file(GLOB source "${headers}/*/shmgen_library.c")
  if(NOT source)
    message(FATAL_ERROR "shmgen_library(${target}): no C headers; add c to the TARGETS of shmgen_generate(${target})")
  endif()
  string(REGEX REPLACE "c$" "map" map "${source}")
  foreach(kind IN ITEMS SHARED STATIC)
    string(TOLOWER "shmgen_${kind}" library)
    add_library(${library} ${kind} "${source}")
    add_dependencies(${library} ${target}_files)
    target_link_libraries(${library} PUBLIC pthread rt)
    set_target_properties(${library} PROPERTIES OUTPUT_NAME shmgen C_STANDARD 11 POSITION_INDEPENDENT_CODE ON SOVERSION 2)
  endforeach()
  target_link_options(shmgen_shared PRIVATE "LINKER:--version-script=${map}")
  include(GNUInstallDirs)
  file(WRITE "${CMAKE_CURRENT_BINARY_DIR}/shmgen.pc"
    "libdir=${CMAKE_INSTALL_FULL_LIBDIR}\n\n"
    "Name: shmgen\nDescription: ROS messages in shared memory, between a robot and a soft PLC\nVersion: 2\n"
    "Cflags: -I${CMAKE_INSTALL_PREFIX}/${installed}\nLibs: -L\${libdir} -lshmgen\nLibs.private: -lpthread -lrt\n")
  if(ARG_INSTALL)
    install(TARGETS shmgen_shared shmgen_static DESTINATION "${CMAKE_INSTALL_LIBDIR}")
    install(FILES "${CMAKE_CURRENT_BINARY_DIR}/shmgen.pc" DESTINATION "${CMAKE_INSTALL_LIBDIR}/pkgconfig")
  endif()
endfunction()

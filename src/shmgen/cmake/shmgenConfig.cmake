# find_package(shmgen) gives shmgen_generate(): bindings written at build time, and a target to link headers from.
#
#   shmgen_generate(<target>
#     [CONFIG <shmgen.toml>]       default: the one beside CMakeLists.txt
#     [INCLUDE <folder>...]        where message packages are looked for before all others
#     [OUTPUT <folder>]            default: <build folder>/<target>
#     [TARGETS <target>...]        what to write, c and cpp and so on; default: the `targets` of shmgen.toml
#     [MESSAGES <type|package>...] what to write it of; default: the `messages` of shmgen.toml
#     [LINK <folder>...]           where another call has installed its layout.lock: what that has written is not written
#                                  again, so link its target too
#     [OPTIONAL]                   leave out messages without a bound; if nothing can be written, warn and make no <target>
#     [HEADERS <folder>]           where they are installed; default: include
#     [INSTALL])                   headers, and Python, Structured Text and layout.lock to share/<project>/shmgen
#
# <target> is an INTERFACE library: linked, it gives the headers of OUTPUT/c, cpp, cpp_ros1 and cpp_ros2, and what they
# need of the system. Python is in OUTPUT/python. All is written anew when shmgen.toml, a definition that was read or its
# package.xml has changed, wherever it lies, and when there is one more below the INCLUDE folders or that of shmgen.toml.
#
#   shmgen_library(<target> [INSTALL])
#
# after shmgen_generate(<target>) builds the functions of its C headers as libshmgen.so and libshmgen.a, the targets
# shmgen_shared and shmgen_static, for programs in other languages, and installs them with shmgen.pc for pkg-config.
cmake_minimum_required(VERSION 3.20)

find_program(SHMGEN_EXECUTABLE shmgen HINTS "${CMAKE_CURRENT_LIST_DIR}/../../../bin")
if(NOT SHMGEN_EXECUTABLE)
  set(shmgen_FOUND FALSE)
  set(shmgen_NOT_FOUND_MESSAGE "no program shmgen in PATH: install it with pip, and start from the environment that has it")
  return()
endif()

function(shmgen_generate target)
  cmake_parse_arguments(PARSE_ARGV 1 ARG "INSTALL;OPTIONAL" "CONFIG;OUTPUT;HEADERS" "INCLUDE;TARGETS;MESSAGES;LINK")
  if(ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "shmgen_generate(${target}): what is ${ARG_UNPARSED_ARGUMENTS}?")
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
  foreach(wanted IN LISTS ARG_TARGETS)
    list(APPEND options -t "${wanted}")
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
  # Ninja compiles anew for headers that it knows to be made; what this run fails for, the build says.
  execute_process(COMMAND ${generate} OUTPUT_VARIABLE said ERROR_VARIABLE error RESULT_VARIABLE failed)
  if(ARG_OPTIONAL AND failed)
    message(WARNING "shmgen writes nothing of ${ARG_MESSAGES}:\n${error}")
    return()
  elseif(said MATCHES "[0-9]+ messages? left out.*")
    message(STATUS "shmgen: ${CMAKE_MATCH_0}")
  endif()
  list(TRANSFORM headers APPEND "/*.h*" OUTPUT_VARIABLE patterns)
  file(GLOB_RECURSE made ${patterns})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS "${config}")
  add_custom_command(
    OUTPUT "${stamp}"
    BYPRODUCTS ${made}
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
    target_link_libraries(${target} INTERFACE pthread rt)  # in the C library itself since glibc 2.34
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
    message(FATAL_ERROR "shmgen_library(${target}): it has no C headers; add c to the TARGETS of shmgen_generate(${target})")
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

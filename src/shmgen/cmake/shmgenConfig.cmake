# find_package(shmgen) gives shmgen_generate(): bindings written at build time, and a target to link headers from.
#
#   shmgen_generate(<target>
#     [CONFIG <shmgen.toml>]       default: the one beside CMakeLists.txt
#     [INCLUDE <folder>...]        where message packages are looked for before all others
#     [OUTPUT <folder>]            default: <build folder>/<target>
#     [TARGETS <target>...]        what to write, c and cpp and so on; default: the `targets` of shmgen.toml
#     [INSTALL])                   headers to include/, Python and Structured Text to share/<project>/shmgen
#
# <target> is an INTERFACE library: linked, it gives the headers of OUTPUT/c, cpp, cpp_ros1 and cpp_ros2, and what they
# need of the system. Python is in OUTPUT/python. All is written anew when shmgen.toml, a definition that was read or its
# package.xml has changed, wherever it lies, and when there is one more below the INCLUDE folders or that of shmgen.toml.
cmake_minimum_required(VERSION 3.20)

find_program(SHMGEN_EXECUTABLE shmgen HINTS "${CMAKE_CURRENT_LIST_DIR}/../../../bin")
if(NOT SHMGEN_EXECUTABLE)
  set(shmgen_FOUND FALSE)
  set(shmgen_NOT_FOUND_MESSAGE "no program shmgen in PATH: install it with pip, and start from the environment that has it")
  return()
endif()

function(shmgen_generate target)
  cmake_parse_arguments(PARSE_ARGV 1 ARG "INSTALL" "CONFIG;OUTPUT" "INCLUDE;TARGETS")
  if(ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "shmgen_generate(${target}): what is ${ARG_UNPARSED_ARGUMENTS}?")
  endif()
  if(NOT ARG_CONFIG)
    set(ARG_CONFIG shmgen.toml)
  endif()
  if(NOT ARG_OUTPUT)
    set(ARG_OUTPUT "${CMAKE_CURRENT_BINARY_DIR}/${target}")
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
  set(stamp "${CMAKE_CURRENT_BINARY_DIR}/${target}.stamp")
  set(headers "${ARG_OUTPUT}/c" "${ARG_OUTPUT}/cpp" "${ARG_OUTPUT}/cpp_ros1" "${ARG_OUTPUT}/cpp_ros2")
  set(generate "${SHMGEN_EXECUTABLE}" generate --quiet --config "${config}" --output "${ARG_OUTPUT}" ${options})
  # Ninja compiles anew for headers that it knows to be made; what this run fails for, the build says.
  execute_process(COMMAND ${generate} OUTPUT_QUIET ERROR_QUIET)
  list(TRANSFORM headers APPEND "/*.h*" OUTPUT_VARIABLE patterns)
  file(GLOB_RECURSE made ${patterns})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS "${config}")
  add_custom_command(
    OUTPUT "${stamp}"
    BYPRODUCTS ${made}
    COMMAND ${generate} --depfile "${stamp}.d"
    COMMAND "${CMAKE_COMMAND}" -E touch "${stamp}"
    DEPENDS "${config}" ${definitions}
    DEPFILE "${stamp}.d"
    COMMENT "shmgen generate ${target}"
    VERBATIM)
  add_custom_target(${target}_files ALL DEPENDS "${stamp}")
  add_library(${target} INTERFACE)
  add_dependencies(${target} ${target}_files)
  target_include_directories(${target} SYSTEM INTERFACE ${headers})
  if(UNIX)
    target_link_libraries(${target} INTERFACE pthread rt)  # in the C library itself since glibc 2.34
  endif()
  if(ARG_INSTALL)
    foreach(folder IN LISTS headers)
      install(DIRECTORY "${folder}/" DESTINATION include OPTIONAL)
    endforeach()
    install(DIRECTORY "${ARG_OUTPUT}/python" "${ARG_OUTPUT}/st" "${ARG_OUTPUT}/plcopen"
      DESTINATION "share/${PROJECT_NAME}/shmgen" OPTIONAL PATTERN __pycache__ EXCLUDE)
  endif()
endfunction()

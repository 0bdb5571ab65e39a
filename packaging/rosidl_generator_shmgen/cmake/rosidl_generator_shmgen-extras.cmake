# Whoever finds this package, as rosidl_default_generators does for every interface package, gets it called.
find_package(ament_cmake_core QUIET REQUIRED)
find_package(rosidl_generator_cpp QUIET REQUIRED)  # TypeAdapters are between its classes and ours, so it goes first
find_program(SHMGEN_EXECUTABLE shmgen)
if(SHMGEN_EXECUTABLE)
  file(REAL_PATH "${SHMGEN_EXECUTABLE}" _shmgen)  # pipx has only a link to it in PATH
  cmake_path(GET _shmgen PARENT_PATH _shmgen)
  find_package(shmgen QUIET HINTS "${_shmgen}/../share/shmgen/cmake")
endif()
if(shmgen_FOUND)
  ament_register_extension("rosidl_generate_idl_interfaces" "rosidl_generator_shmgen"
    "rosidl_generator_shmgen_generate_interfaces.cmake")
else()
  message(WARNING "rosidl_generator_shmgen writes nothing: no program shmgen in PATH")
endif()

# Register the generator with every package that finds this package. rosidl_default_generators finds it for all interface packages.
find_package(ament_cmake_core QUIET REQUIRED)
find_package(rosidl_generator_cpp QUIET REQUIRED)  # runs first, because shmgen's TypeAdapters use its classes
find_program(SHMGEN_EXECUTABLE shmgen)
if(SHMGEN_EXECUTABLE)
  file(REAL_PATH "${SHMGEN_EXECUTABLE}" _shmgen)  # pipx puts only a symbolic link into PATH
  cmake_path(GET _shmgen PARENT_PATH _shmgen)
  find_package(shmgen QUIET HINTS "${_shmgen}/../share/shmgen/cmake")
endif()
if(shmgen_FOUND)
  ament_register_extension("rosidl_generate_idl_interfaces" "rosidl_generator_shmgen"
    "rosidl_generator_shmgen_generate_interfaces.cmake")
else()
  message(WARNING "rosidl_generator_shmgen generates no code: the program shmgen is not in PATH")
endif()

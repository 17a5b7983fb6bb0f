# The client's mutex and its users' threads live in a library of their own before glibc 2.34 (Ubuntu 20.04).
# Static libraries cannot say so themselves; after them is where a linker looks for it.
find_package(Threads REQUIRED)
list(APPEND cortex_ros_LIBRARIES ${CMAKE_THREAD_LIBS_INIT})

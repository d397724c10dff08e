# What CMake reads before NLopt's own CMakeLists.txt (.cargo/config.toml names it): NLopt without its LGPL part, the Luksan solvers; what is left
# is under the MIT licence or freer.
set(NLOPT_LUKSAN OFF CACHE BOOL "" FORCE)

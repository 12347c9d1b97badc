#!/bin/sh
# The PCL pipeline needs a compiler and Debian's PCL; name the one line that installs what is missing.
missing=""
command -v g++ >/dev/null 2>&1 || missing="$missing g++"
ls /usr/include/pcl-*/pcl/point_types.h >/dev/null 2>&1 || missing="$missing libpcl-dev"
[ -z "$missing" ] && exit 0
echo "The benchmarks compare with PCL, which this machine lacks. Install it with:" >&2
echo "  sudo apt-get install -y --no-install-recommends$missing" >&2
exit 1

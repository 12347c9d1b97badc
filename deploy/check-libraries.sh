#!/bin/sh
# Open3D links against these shared libraries; name the one line that installs what is missing.
[ "$(uname -s)" = Linux ] || exit 0
missing=""
have() { ldconfig -p 2>/dev/null | grep -q "$1" || /sbin/ldconfig -p 2>/dev/null | grep -q "$1"; }
have libGL.so.1 || missing="$missing libgl1"
have libEGL.so.1 || missing="$missing libegl1"
have libX11.so.6 || missing="$missing libx11-6"
have libudev.so.1 || missing="$missing libudev1"
have libusb-1.0.so.0 || missing="$missing libusb-1.0-0"
have libgomp.so.1 || missing="$missing libgomp1"
[ -z "$missing" ] && exit 0
echo "Open3D needs shared libraries that this machine lacks. Install them with:" >&2
echo "  sudo apt-get install -y$missing" >&2
exit 1

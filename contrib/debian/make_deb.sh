#!/bin/sh
# Makes shmgen_VERSION_ARCHITECTURE.deb in the folder where it is called, for the Debian or Ubuntu it runs on:
#     contrib/debian/make_deb.sh && sudo apt install ./shmgen_*.deb
# What reads .idl is python3-rosidl, which apt brings with it. What is not Debian's own (rosbags and others) is in /usr/lib/shmgen, where no other program sees it.
# Needs python3-venv. With gcc and python3-dev there, publish and read are quicker. DEBFULLNAME and DEBEMAIL are who answers for it.
set -eu
source=$(cd "$(dirname "$0")/../.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
root=$work/root
mkdir -p "$root/DEBIAN" "$root/usr/bin" "$root/usr/lib/shmgen" "$root/usr/share/doc/shmgen"
chmod 755 "$root"

python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --target "$root/usr/lib/shmgen" "$source"
rm -rf "$root/usr/lib/shmgen/bin"
cat > "$root/usr/bin/shmgen" <<'PROGRAM'
#!/usr/bin/python3
import sys

sys.path.insert(1, "/usr/lib/shmgen")  # rospy and rclpy are found as for any program of this Python
from shmgen.__main__ import main

sys.exit(main())
PROGRAM
chmod 755 "$root/usr/bin/shmgen"
cp "$source/LICENSE" "$root/usr/share/doc/shmgen/copyright"

version=$(sed -n 's/^__version__ = "\(.*\)"/\1/p' "$source/src/shmgen/__init__.py")
architecture=$(dpkg --print-architecture)
python=$(python3 -c 'import sys; print("python3 (>= 3.%d), python3 (<< 3.%d)" % (sys.version_info[1], sys.version_info[1] + 1))')
cat > "$root/DEBIAN/control" <<CONTROL
Package: shmgen
Version: $version
Architecture: $architecture
Maintainer: ${DEBFULLNAME:-$(id -un)} <${DEBEMAIL:-$(id -un)@localhost}>
Installed-Size: $(du -sk "$root/usr" | cut -f1)
Depends: $python
Recommends: python3-rosidl
Section: devel
Priority: optional
Description: Shared-memory bridge code between CODESYS softPLCs and ROS
 Reads ROS message definitions and writes the code for both sides, all from one memory layout.
CONTROL
# dpkg does not know what Python has compiled there, where root ran it.
cat > "$root/DEBIAN/postrm" <<'REMOVED'
#!/bin/sh
set -e
if [ "$1" = remove ] || [ "$1" = purge ]; then rm -rf /usr/lib/shmgen; fi
REMOVED
chmod 755 "$root/DEBIAN/postrm"
dpkg-deb --root-owner-group --build "$root" "shmgen_${version}_$architecture.deb"

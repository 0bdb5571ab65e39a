#!/bin/sh
# Build shmgen_VERSION_ARCHITECTURE.deb in the current folder, for the Debian or Ubuntu of this machine:
#     contrib/debian/make_deb.sh && sudo apt install ./shmgen_*.deb
# apt also installs python3-rosidl, which reads .idl. Packages that Debian lacks, such as rosbags, are installed into /usr/lib/shmgen, where
# other programs do not find them. The script requires python3-venv. With gcc and python3-dev, the package contains the faster extension in C.
# DEBFULLNAME and DEBEMAIL name the maintainer of the package.
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

sys.path.insert(1, "/usr/lib/shmgen")  # rospy and rclpy are found as in all programs of this Python
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
Description: Shared-memory bridge code between CODESYS soft PLCs and ROS
 shmgen reads ROS message definitions and generates the code of both sides from one memory layout.
CONTROL
# If root has run shmgen, Python has written bytecode there that dpkg does not know.
cat > "$root/DEBIAN/postrm" <<'REMOVED'
#!/bin/sh
set -e
if [ "$1" = remove ] || [ "$1" = purge ]; then rm -rf /usr/lib/shmgen; fi
REMOVED
chmod 755 "$root/DEBIAN/postrm"
dpkg-deb --root-owner-group --build "$root" "shmgen_${version}_$architecture.deb"

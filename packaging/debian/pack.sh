#!/bin/sh
# Makes the package from a folder that has the environment in opt/lidarcodec; build.sh calls it.
#   packaging/debian/pack.sh STAGE OUT PYTHON
set -eu
stage=$1 out=$2 python=$3
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
home=$stage/opt/lidarcodec
version=$(basename "$home"/lib/python3*/site-packages/lidarcodec-*.dist-info .dist-info)
version=${version#lidarcodec-}
maintainer='lidarcodec <lidarcodec@localhost>'
architecture=$(dpkg --print-architecture)
SOURCE_DATE_EPOCH=$(git -C "$root" log -1 --format=%ct 2>/dev/null || date +%s)
export SOURCE_DATE_EPOCH
umask 022

# The environment was made in a folder that the vehicle does not have. Only the command itself is kept beside Python.
find "$home/bin" -type f ! -name lidarcodec -delete
find "$home" -name direct_url.json -delete
find "$home/lib" -type f -name '*.so*' -exec chmod a-x {} +
ln -sf "$python" "$home/bin/python3"
sed -i "s|$stage||g" "$home/bin/lidarcodec" "$home/pyvenv.cfg"
"$python" -m compileall -q -j 2 -s "$stage" -p / --invalidation-mode unchecked-hash "$home/lib"

install -d "$stage/usr/bin" "$stage/lib/systemd/system" "$stage/usr/lib/sysusers.d" "$stage/etc/lidarcodec" \
  "$stage/usr/share/doc/lidarcodec/examples" "$stage/usr/share/lintian/overrides" "$stage/DEBIAN"
ln -sf /opt/lidarcodec/bin/lidarcodec "$stage/usr/bin/lidarcodec"
install -m 644 "$root"/packaging/*.service "$root"/packaging/*.timer "$stage/lib/systemd/system"
install -m 644 "$root/packaging/lidarcodec.sysusers" "$stage/usr/lib/sysusers.d/lidarcodec.conf"
install -m 644 "$root/packaging/publish.yaml" "$here/environment" "$stage/etc/lidarcodec"
install -m 644 "$root/packaging/zenoh-router.json5" "$root/packaging/zenoh-port.nft" "$stage/usr/share/doc/lidarcodec/examples"
install -m 644 "$here/README.Debian" "$here/copyright" "$stage/usr/share/doc/lidarcodec"
install -m 644 "$here/lintian-overrides" "$stage/usr/share/lintian/overrides/lidarcodec"
gzip -9n < "$root/CHANGELOG.md" > "$stage/usr/share/doc/lidarcodec/CHANGELOG.md.gz"
gzip -9n > "$stage/usr/share/doc/lidarcodec/changelog.gz" <<CHANGES
lidarcodec ($version) unstable; urgency=medium

  * What changed is in CHANGELOG.md.gz beside this file.

 -- $maintainer  $(LC_ALL=C date --utc --rfc-email --date="@$SOURCE_DATE_EPOCH")
CHANGES

install -m 755 "$here/postinst" "$here/prerm" "$here/postrm" "$stage/DEBIAN"
printf '/etc/lidarcodec/%s\n' environment publish.yaml > "$stage/DEBIAN/conffiles"
depends=$(dpkg-query --show --showformat '${Package} (>= ${Version}), ' libc6 libstdc++6 | sed 's/-[^-)]*)/)/g')
cat > "$stage/DEBIAN/control" <<CONTROL
Package: lidarcodec
Version: $version
Architecture: $architecture
Maintainer: $maintainer
Section: misc
Priority: optional
Installed-Size: $(du -sk "$stage" | cut -f1)
Depends: ${depends}$(basename "$python"), systemd
Recommends: chrony | time-daemon
Homepage: https://github.com/lidarcodec/lidarcodec
Description: streaming codec for LiDAR packets, with systemd units
 Sends, records and receives the packets of LiDARs with a fraction of
 their bits, and serves a page that shows them. The package has
 everything in /opt/lidarcodec, so that it needs no network.
CONTROL
(cd "$stage" && find . -type f ! -path './DEBIAN/*' -printf '%P\0' | LC_ALL=C sort -z | xargs -0r md5sum) > "$stage.md5sums"
mv "$stage.md5sums" "$stage/DEBIAN/md5sums"
find "$stage" -exec touch --no-dereference --date="@$SOURCE_DATE_EPOCH" {} +
mkdir -p "$out"
# xz at its own level takes many minutes for half a gigabyte; at this one half a minute.
dpkg-deb --root-owner-group -Zxz -z1 --build "$stage" "$out"

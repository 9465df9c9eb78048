#!/usr/bin/env bash
# Run the tests with the Python of Debian 13, which is 3.13, on a fresh clone in a chroot.
#
#     scripts/test_in_debian.sh DIR [MIRROR [TARGET]]
#
# makes a small Debian in DIR, if none is there yet, and runs `make TARGET` in it; by default from
# Debian's own mirror, and `make test`. Only what is committed is tested. It must be run by root,
# and needs debootstrap and 10 GB of disk. What pip and certificates are told here holds there too.
set -euo pipefail

if [ $# -lt 1 ] || [ $# -gt 3 ]; then
  echo "usage: $0 DIR [MIRROR [TARGET]]" >&2
  exit 2
fi
mirror=${2:-} # empty: what debootstrap takes by itself
target=${3:-test}
repository=$(git -C "$(dirname "$0")" rev-parse --show-toplevel)
packages=python3,python3-venv,make,git,ca-certificates,libgl1,libegl1

mkdir -p "$1"
root=$(cd "$1" && pwd)
if [ ! -e "$root/etc/debian_version" ] || [ -e "$root/debootstrap" ]; then
  debootstrap --variant=minbase --include="$packages" trixie "$root" ${mirror:+"$mirror"}
fi

# What the machine needs to reach a package index.
for path in /etc/resolv.conf /etc/pip.conf /etc/xdg/pip "${HOME:-/root}/.config/pip" \
  /usr/local/share/ca-certificates; do
  if [ -e "$path" ]; then
    there=${path/#"${HOME:-/root}"/\/root}
    mkdir -p "$root$(dirname "$there")"
    cp -rLT "$path" "$root$there"
  fi
done
chroot "$root" update-ca-certificates

rm -rf "$root/root/torch_iac"
git clone --quiet --no-hardlinks "$repository" "$root/root/torch_iac"

leave() {
  umount -l "$root/dev" "$root/proc" 2>/dev/null || true
}
trap leave EXIT
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount --make-rslave "$root/dev" # so that unmounting here unmounts nothing outside
HOME=/root chroot "$root" make -C /root/torch_iac "$target"

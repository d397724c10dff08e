#!/usr/bin/env bash
# Builds target/package/wcal_VERSION_amd64.deb and, with the same tree in it, wcal-VERSION-x86_64.tar.gz.
# WCAL_PROFILE: Cargo's profile (release). WCAL_BUILD=no: the programs of that profile are taken as they are.
# The same programs give the same bytes: times are those of the commit, names sorted, owners root.
set -euo pipefail
cd "$(dirname "$0")/.."
umask 022
export LC_ALL=C SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
profile=${WCAL_PROFILE:-release}
programs=target/$([ "$profile" = dev ] && echo debug || echo "$profile")
package=target/package
root=$package/root
doc=$root/usr/share/doc/wcal

fail() { echo "packaging/build.sh: $*" >&2; exit 1; }

[ "$(uname -s -m)" = "Linux x86_64" ] || fail "expected Linux x86_64, found $(uname -s -m)"
for tool in dpkg-deb dpkg-shlibdeps patchelf strip; do
  command -v $tool >/dev/null || fail "expected $tool, found none (make package installs it)"
done
calib/mujoco/engine/fetch.sh
if [ "${WCAL_BUILD:-yes}" != no ]; then
  cargo build --profile "$profile" --locked -p wcal -p wcal-mujoco-engine -p wcal-lab --bin wcal --bin wcal-mujoco --bin wcal-lab
fi
for name in wcal wcal-mujoco wcal-lab; do
  [ -x "$programs/$name" ] || fail "expected $programs/$name, found none"
done
version=$("$programs/wcal" --version | cut -d ' ' -f 2)
deb=$package/wcal_${version}_amd64.deb tar=$package/wcal-$version-x86_64.tar.gz
rm -rf "$package"
mkdir -p "$doc/examples" "$root/DEBIAN" "$package/debian"

# The programs, without symbols. The engine finds its libraries from where it lies, in the archive too.
for name in wcal wcal-mujoco; do
  install -D "$programs/$name" "$root/usr/bin/$name"
  strip "$root/usr/bin/$name"
done
patchelf --set-rpath '$ORIGIN/../lib/wcal/mujoco' "$root/usr/bin/wcal-mujoco"
(cd native && find mujoco coacd -name '*.so*' -exec install -D -m 644 {} "../$root/usr/lib/wcal/{}" \;)
hello=$(echo '{"do":"hello"}' | "$root/usr/bin/wcal-mujoco") || fail "wcal-mujoco does not start"
case $hello in *mujoco*3.17.0*) ;; *) fail "expected MuJoCo 3.17.0 in wcal-mujoco, found $hello" ;; esac

# Manual pages and completions.
"$programs/wcal-lab" man --out $package/man >/dev/null
for page in $package/man/*.1; do
  install -D -m 644 "$page" "$root/usr/share/man/man1/${page##*/}"
done
gzip -9n "$root"/usr/share/man/man1/*
install -D -m 644 $package/man/wcal.bash "$root/usr/share/bash-completion/completions/wcal"
install -D -m 644 $package/man/_wcal "$root/usr/share/zsh/vendor-completions/_wcal"
install -D -m 644 $package/man/wcal.fish "$root/usr/share/fish/vendor_completions.d/wcal.fish"

# What the guide's commands run on, as they name it, and the pages that help and errors name.
fixtures=$(grep -oh 'fixtures/[a-z_]*' docs/src/guide/*.md README.md | sort -u)
git ls-files -z examples/templates rigs/paper rigs/plans rigs/virtual $fixtures | xargs -0 cp --parents -t "$doc/examples"
git ls-files -z docs/src | xargs -0 cp --parents -t "$doc"

# Licences: ours, those of MuJoCo and CoACD, and the notices of every Rust package that a program is made of.
cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE THIRD-PARTY.md "$doc"
cat - LICENSE-MIT LICENSE-APACHE THIRD-PARTY.md >"$doc/copyright" <<'TEXT'
wcal is under the MIT licence or the Apache licence 2.0, at your choice; both texts follow, then what others wrote.
Their licences stand beside this file: native/ (MuJoCo, CoACD) and THIRD-PARTY-LICENSES.gz (Rust packages and what they hold).
The recordings under examples/fixtures have theirs in the SOURCE.md of each folder.
libgomp (/usr/lib/wcal/coacd) is under GPL-3.0-or-later with the GCC runtime exception: /usr/share/common-licenses/GPL-3.

TEXT
(cd native && find . -path '*dist-info*' -name 'LICENSE*' -exec install -D -m 644 {} "../$doc/native/{}" \;)
sources=$(cargo metadata --locked --offline --format-version 1 --filter-platform x86_64-unknown-linux-gnu |
  python3 -c 'import json, sys
for p in json.load(sys.stdin)["packages"]: print(p["name"], p["version"], p["manifest_path"].removesuffix("/Cargo.toml"))')
sed '1,/^## Rust packages/d' THIRD-PARTY.md | sed -n 's/^| \([^ ]*\) \([0-9][^ ]*\) | \([^|]*\) | .*/\1 \2 \3/p' |
  while read -r name number licence; do
    folder=$(awk -v n="$name" -v v="$number" '$1 == n && $2 == v { print $3; exit }' <<<"$sources")
    [ -d "$folder" ] || fail "$name $number: expected its source, found none"
    printf '\n======== %s %s: %s\n' "$name" "$number" "$licence"
    find "$folder" -type f \( -iname 'licen[cs]e*' -o -iname 'copying*' -o -iname 'notice*' -o -iname 'copyright*' \) \
      ! -name '*.rs' ! -name '*.html' -print0 | sort -z | xargs -0r cat
  done >$package/licences
gzip -9n <$package/licences >"$doc/THIRD-PARTY-LICENSES.gz"

# What the libraries of Debian that the programs load are called there.
printf 'Source: wcal\n\nPackage: wcal\nArchitecture: amd64\n' >$package/debian/control
depends=$(cd $package && dpkg-shlibdeps -O --ignore-missing-info -lroot/usr/lib/wcal/mujoco -lroot/usr/lib/wcal/coacd/coacd.libs \
  $(find root/usr/bin root/usr/lib -type f -printf '-e%p ') 2>shlibdeps.log) || fail "$(cat $package/shlibdeps.log)"
cat >"$root/DEBIAN/control" <<TEXT
Package: wcal
Version: $version
Architecture: amd64
Maintainer: The wcal developers <wcal@example.invalid>
Installed-Size: $(du -k --apparent-size -s "$root/usr" | cut -f1)
Depends: ${depends#shlibs:Depends=}
Section: science
Priority: optional
Description: calibrates whisker touch sensors and other transducers
 Finds the residual between readings and model, names the effect, adds it,
 and shows the error before and after. With its MuJoCo engine, manual pages
 and the recordings that the guide uses.
TEXT
(cd "$root" && find usr -type f -print0 | sort -z | xargs -0 md5sum >DEBIAN/md5sums)

chmod -R u=rwX,go=rX "$root"
find "$root" -exec touch -h -d "@$SOURCE_DATE_EPOCH" {} +
dpkg-deb --root-owner-group --threads-max=1 --build "$root" "$deb" >/dev/null
tar -C "$root" --sort=name --mtime="@$SOURCE_DATE_EPOCH" --owner=0 --group=0 --numeric-owner --transform "s,^usr,wcal-$version," -cf - usr |
  gzip -9n >"$tar"
ls -l "$deb" "$tar"

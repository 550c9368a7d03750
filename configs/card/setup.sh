#!/bin/sh
# Make a Decklander card of an unpacked Raspberry Pi OS 13: sh setup.sh ROOT PACKAGE.deb PROFILE
# The layer runs it as a hook, with this folder as the working one; so does qualification/packaging/card.py, on a bare Debian.
set -eu
root=$1 package=$2 profile=$3

install -m 644 "$package" "$root/tmp/decklander.deb"
chroot "$root" apt-get install --yes --no-install-recommends /tmp/decklander.deb
rm "$root/tmp/decklander.deb"

# The header's UART is the autopilot's: /dev/ttyAMA0 on a Pi 4 and a Pi 5, and no console talks there.
printf '\n[pi4]\ndtoverlay=disable-bt\n[pi5]\ndtparam=uart0=on\n[all]\nenable_uart=1\n' >> "$root/boot/firmware/config.txt"
sed -i -E 's/console=(serial[0-9]+|ttyS[0-9]+|ttyAMA[0-9]+),[0-9a-z]+ *//g' "$root/boot/firmware/cmdline.txt"
for port in serial0 ttyAMA0 ttyS0; do
    ln -sfn /dev/null "$root/etc/systemd/system/serial-getty@$port.service"
done

# The shipped settings of the profile, and the page for this network. Its token and key are made by the first boot.
shipped=$(chroot "$root" /opt/decklander/current/bin/python -c 'import configs; print(configs.__path__[0])')
mkdir -p "$root/etc/decklander"
cat "$root$shipped/$profile.toml" rig.page.toml > "$root/etc/decklander/rig.toml"
install -m 755 first-boot.sh "$root/usr/local/sbin/decklander-first-boot"
install -m 644 decklander-first-boot.service "$root/etc/systemd/system/"
chroot "$root" systemctl enable decklander decklander-first-boot

#!/bin/sh
# Make what must differ from card to card: the page's token and key. Then say where the page is, at the login and on the screen.
set -eu
umask 077
store=/etc/credstore
mkdir -p "$store"
[ -s "$store/decklander.page" ] || decklander keys token "$store/decklander.page"
if [ ! -s /etc/decklander/page.crt ]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 -subj /CN=decklander \
        -addext "subjectAltName=DNS:$(uname -n).local" -keyout "$store/decklander.page-key" -out /etc/decklander/page.crt
    chmod 644 /etc/decklander/page.crt
fi
umask 022
mkdir -p /etc/issue.d /etc/motd.d
line="Decklander: open https://$(uname -n).local:8480/ and enter the token that 'sudo cat $store/decklander.page' prints"
echo "$line" | tee /etc/issue.d/decklander.issue > /etc/motd.d/decklander

# Makes what a broker needs the first time, then is the broker. /var/lib/mosquitto is its own; /keys is what its clients get,
# /scrape what the daemon and Prometheus share: the folder's group, which Prometheus runs in, is passed on to the token.
set -eu
umask 077
cd /var/lib/mosquitto

if [ ! -f certs/server.crt ]; then
    rm -rf certs.new && mkdir certs.new && cd certs.new
    key="-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes"
    openssl req -x509 $key -days 3650 -subj /CN=decklander-ca -addext keyUsage=critical,keyCertSign,cRLSign -keyout ca.key -out ca.crt
    openssl req -new $key -subj /CN=broker -keyout server.key -out server.csr
    printf '%s\n' subjectAltName=DNS:broker,DNS:localhost,IP:127.0.0.1 authorityKeyIdentifier=keyid > names
    openssl x509 -req -in server.csr -CA ca.crt -CAkey ca.key -CAcreateserial -days 825 -extfile names -out server.crt
    cd .. && mv certs.new certs
    rm -f decklander.passwords
fi 2>/dev/null
cp certs/ca.crt /keys/ca.crt

if [ ! -f decklander.passwords ]; then
    rm -f passwords.new && touch passwords.new
    for user in sea ground display; do
        openssl rand -hex 16 > "/keys/$user.password"
        mosquitto_passwd -b passwords.new "$user" "$(cat "/keys/$user.password")"
    done
    mv passwords.new decklander.passwords
fi

if [ ! -s /scrape/metrics.token ]; then
    openssl rand -hex 32 > /scrape/token.new
    chmod 640 /scrape/token.new
    mv /scrape/token.new /scrape/metrics.token
fi

exec mosquitto -c /etc/mosquitto/conf.d/decklander.conf

#!/bin/busybox sh
# What the emulated computer does, from its start to its end. It judges nothing: what was said and how it ended goes to
# the folder that it shares with `cargo xtask linux`, which does.
#
# HALF is half the seconds of traffic in sent.log, as an argument of the kernel.

/bin/busybox --install -s /bin
export PATH=/bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
mount -t tmpfs -o size=90% tmp /tmp
while read -r module; do insmod "/modules/$module"; done < /modules/order
mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144 share /share || poweroff -f
cd /tmp || poweroff -f
uname -r > /share/kernel

# say NAME COMMAND...: what it prints to NAME.out and NAME.err, how it ends to NAME.status
say() {
    name=$1
    shift
    "$@" > "$name.out" 2> "$name.err"
    echo $? > "$name.status"
    echo "$(cut -d . -f 1 /proc/uptime) s: $name"
}

# Until so many sockets listen to the interface.
listening() {
    until [ "$(grep -c vcan0 /proc/net/can/rcvlist_all)" = "$1" ]; do usleep 20000; done
}

# Frames that the kernel has handed out.
received() { awk '/received frames \(RXF\)/ { print $1 }' /proc/net/can/stats; }

# Files between the share and here, in pieces that it likes: cp's are a page.
bring() { dd if="/share/$1" of="$1" bs=256k 2>> dd.log; }
give() { for file; do dd if="$file" of="/share/$file" bs=256k 2>> dd.log; done; }

bring sent.log

# What somebody can get wrong, before the interface is as it should be.
say no-interface slipsense record socketcan:nocan0 no.mcap
ip link add vcan0 type vcan
say down slipsense record socketcan:vcan0 no.mcap
ip link set vcan0 mtu 16
ip link set vcan0 up
say classic slipsense record socketcan:vcan0 no.mcap
say classic-replay slipsense replay sent.log socketcan:vcan0
ip link set vcan0 down
ip link set vcan0 mtu 72
ip link set vcan0 up
# As `slipsense record --help` says; the emulated computer is a slow one.
echo 8388608 > /proc/sys/net/core/rmem_max

# A recording of all of it, ended as Ctrl-C does.
say first-record slipsense record socketcan:vcan0 first.mcap first.log --json &
listening 1
say first-replay slipsense replay sent.log socketcan:vcan0 --json
sleep 1
killall -INT slipsense
wait
give first.mcap first.log
rm first.log

# That recording replayed, to a recorder that does not get the processor for half a second.
say second-record slipsense record socketcan:vcan0 second.log --json &
listening 1
recorder=$(pidof slipsense)
before=$(received)
say second-replay slipsense replay first.mcap socketcan:vcan0 --json &
while [ "$(received)" = "$before" ]; do usleep 20000; done
sleep 1
kill -STOP "$recorder"
usleep 500000
kill -CONT "$recorder"
until [ -e second-replay.status ]; do usleep 100000; done
sleep 1
killall -INT slipsense
wait
give second.log
rm second.log first.mcap

# A recorder that is killed in the middle, beside a monitor that lives on.
slipsense record socketcan:vcan0 killed.mcap killed.log &
recorder=$!
listening 1
say live slipsense monitor socketcan:vcan0 --plain --json &
listening 2
before=$(received)
slipsense replay sent.log socketcan:vcan0 &
replay=$!
while [ "$(received)" = "$before" ]; do usleep 20000; done
sleep "$HALF"
after=$(received)
kill -KILL $recorder
echo $((after - before)) > at-kill
kill -TERM $replay
sleep 1
killall -INT slipsense
wait
say open slipsense convert killed.mcap opened.log --json
say watch slipsense monitor killed.mcap --plain --json
give killed.mcap killed.log opened.log at-kill

# An interface that goes away in the middle.
say gone slipsense record socketcan:vcan0 gone.log &
listening 1
head -n 2000 sent.log > short.log
slipsense replay short.log socketcan:vcan0
sleep 1
ip link del vcan0
wait
give gone.log

give ./*.out ./*.err ./*.status
cat /proc/uptime > /share/end
poweroff -f

# What a host does before its first process: ROOT NAME SHM_SIZE COMMAND...
# It runs in namespaces of its own, as root still; COMMAND gives that up.
set -e
root=$1 name=$2 shm_size=$3
shift 3
mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys"
mount -t tmpfs -o mode=755 tmpfs "$root/dev"
for device in null zero full random urandom tty; do
    touch "$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
done
ln -s /proc/self/fd "$root/dev/fd"
mkdir "$root/dev/shm"
mount -t tmpfs -o "mode=1777,size=$shm_size" tmpfs "$root/dev/shm"
hostname "$name"
read -r _ # until it has a network
cd "$root"
pivot_root . .
umount -l .
cd /
exec "$@"

#include "cortex_ros/net.hpp"

#include <ifaddrs.h>
#include <linux/filter.h>
#include <linux/sock_diag.h>
#include <net/if.h>
#include <sys/socket.h>

#include <boost/asio/buffer.hpp>
#include <boost/asio/ip/multicast.hpp>
#include <cerrno>
#include <cstring>
#include <iterator>
#include <memory>
#include <utility>

namespace cortex_ros {
namespace {

using boost::asio::ip::udp;
using boost::system::error_code;

constexpr int kReceiveBufferBytes = 1 << 20;   // as in the original client: about two seconds of frames
constexpr std::uint32_t kSample = 1024;        // one in this many datagrams from other senders gets through
constexpr std::size_t kDatagramSpace = 65536;  // larger than any datagram, so MSG_TRUNC means a fault

void check(const error_code& error, const std::string& what) {
  if (error) {
    throw NetworkError(error, what);
  }
}

// For socket options that asio does not have.
void set_option(int fd, int level, int name, int value) {
  if (setsockopt(fd, level, name, &value, sizeof value) != 0) {
    check({errno, boost::system::system_category()}, "cannot set option " + std::to_string(name));
  }
}

std::optional<Time> kernel_time(msghdr& header) {
  for (cmsghdr* c = CMSG_FIRSTHDR(&header); c != nullptr; c = CMSG_NXTHDR(&header, c)) {
    if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SCM_TIMESTAMPNS) {
      timespec stamp;
      std::memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
      return std::chrono::seconds(stamp.tv_sec) + Time(stamp.tv_nsec);
    }
  }
  return std::nullopt;
}

// Number of datagrams that the kernel has dropped for a socket since it was opened.
std::uint32_t dropped(int fd) {
  std::uint32_t memory[SK_MEMINFO_VARS] = {};
  socklen_t size = sizeof memory;
  getsockopt(fd, SOL_SOCKET, SO_MEMINFO, memory, &size);
  return memory[SK_MEMINFO_DROPS];
}

Address from_sockaddr(const sockaddr* address) {
  sockaddr_in in;
  std::memcpy(&in, address, sizeof in);
  return Address(ntohl(in.sin_addr.s_addr));
}

}  // namespace

std::string to_string(const Endpoint& endpoint) {
  return endpoint.address().to_string() + ":" + std::to_string(endpoint.port());
}

Address resolve(const std::string& name) {
  error_code error;
  if (name.find_first_not_of("0123456789.") == std::string::npos) {  // the resolver takes 10.1 for 10.0.0.1
    const Address address = boost::asio::ip::make_address_v4(name, error);
    check(error, "'" + name + "' is not a dotted quad");
    return address;
  }
  boost::asio::io_context context;
  const auto found = udp::resolver(context).resolve(udp::v4(), name, "", error);
  check(error, "cannot resolve '" + name + "' (give it as a dotted quad, or add it to /etc/hosts)");
  return found->endpoint().address().to_v4();
}

Address source_address_towards(const Address& destination) {
  // Connecting a UDP socket sends nothing; it only makes the kernel look up the route.
  boost::asio::io_context context;
  udp::socket probe(context, udp::v4());
  error_code error;
  probe.connect({destination, 9}, error);
  return error ? Address() : probe.local_endpoint().address().to_v4();
}

std::vector<Address> broadcast_addresses(const Address& local) {
  std::vector<Address> out{Address::broadcast()};
  if (local.is_loopback()) {
    // Interfaces do not list this address, but the kernel treats it as a broadcast, which a host on this
    // machine receives.
    out.push_back(boost::asio::ip::make_address_v4("127.255.255.255"));
  }
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) {
    return out;
  }
  const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> owner(list, &freeifaddrs);
  for (const ifaddrs* i = list; i != nullptr; i = i->ifa_next) {
    const unsigned needed = IFF_UP | IFF_BROADCAST;
    const bool able = i->ifa_addr != nullptr && i->ifa_addr->sa_family == AF_INET &&
                      (i->ifa_flags & needed) == needed && i->ifa_broadaddr != nullptr;
    if (able && (local.is_unspecified() || local == from_sockaddr(i->ifa_addr))) {
      out.push_back(from_sockaddr(i->ifa_broadaddr));
    }
  }
  return out;
}

UdpSocket::UdpSocket(const Endpoint& local, Share share) : buffer_(kDatagramSpace) {
  socket_.open(udp::v4());
  socket_.non_blocking(true);
  socket_.set_option(udp::socket::broadcast(true));
  socket_.set_option(udp::socket::receive_buffer_size(kReceiveBufferBytes));
  socket_.set_option(udp::socket::reuse_address(share == Share::kYes));
  set_option(fd(), SOL_SOCKET, SO_TIMESTAMPNS, 1);
  // With this option on, a socket bound to the wildcard address would receive every group that any program of
  // the machine has joined.
  set_option(fd(), IPPROTO_IP, IP_MULTICAST_ALL, 0);
  error_code error;
  socket_.bind(local, error);
  check(error, "cannot bind UDP " + to_string(local));
}

void UdpSocket::join(const Address& group, const Address& interface) {
  error_code error;
  socket_.set_option(boost::asio::ip::multicast::join_group(group, interface), error);
  if (error != boost::asio::error::address_in_use) {
    check(error, "cannot join group " + group.to_string() + " on interface " + interface.to_string());
  }
}

bool UdpSocket::hear_only(const Address& source) {
  constexpr std::uint32_t kSourceAddress = static_cast<std::uint32_t>(SKF_NET_OFF) + 12;  // of the IP header
  constexpr std::uint32_t kRandom = static_cast<std::uint32_t>(SKF_AD_OFF + SKF_AD_RANDOM);
  constexpr std::uint32_t kAllBytes = 0x40000;
  sock_filter program[] = {
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, kSourceAddress),
      BPF_JUMP(BPF_JMP | BPF_JEQ, source.to_uint(), 2, 0),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, kRandom),
      BPF_JUMP(BPF_JMP | BPF_JSET, kSample - 1, 1, 0),
      BPF_STMT(BPF_RET, kAllBytes),
      BPF_STMT(BPF_RET, 0),
  };
  const sock_fprog filter{std::size(program), program};
  refused_ = dropped(fd());
  if (setsockopt(fd(), SOL_SOCKET, SO_ATTACH_FILTER, &filter, sizeof filter) != 0) {
    refused_.reset();
  }
  return refused_.has_value();
}

void UdpSocket::hear_all() {
  if (refused_) {
    set_option(fd(), SOL_SOCKET, SO_DETACH_FILTER, 0);
    refused_.reset();
  }
}

std::uint32_t UdpSocket::newly_refused() {
  if (!refused_) {
    return 0;
  }
  const std::uint32_t before = std::exchange(*refused_, dropped(fd()));
  return *refused_ - before;
}

// Uses recvmsg, because asio does not give access to the kernel's time stamp.
bool UdpSocket::receive(Datagram& datagram) {
  iovec space{buffer_.data(), buffer_.size()};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(timespec))];
  // An error caused by an earlier send is reported here once and says nothing about waiting datagrams.
  for (int attempt = 0; attempt < 8; ++attempt) {
    msghdr header{};
    header.msg_name = datagram.source.data();
    header.msg_namelen = static_cast<socklen_t>(datagram.source.capacity());
    header.msg_iov = &space;
    header.msg_iovlen = 1;
    header.msg_control = control;
    header.msg_controllen = sizeof control;
    const ssize_t size = recvmsg(fd(), &header, 0);
    if (size >= 0) {
      datagram.data = buffer_.data();
      datagram.size = static_cast<std::size_t>(size);
      datagram.truncated = (header.msg_flags & MSG_TRUNC) != 0;
      datagram.kernel_time = kernel_time(header);
      return true;
    }
    if (errno == EAGAIN || errno == EWOULDBLOCK) {
      return false;
    }
  }
  return false;
}

bool UdpSocket::send(const Bytes& packet, const Endpoint& destination) {
  error_code error;
  socket_.send_to(boost::asio::buffer(packet), destination, 0, error);
  return !error;
}

}  // namespace cortex_ros

#include "cortex_ros/net.hpp"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <regex>
#include <utility>

namespace cortex_ros {
namespace {

constexpr int kReceiveBufferBytes = 1 << 20;   // as the original client: about two seconds of frames
constexpr std::size_t kDatagramSpace = 65536;  // larger than any datagram, so MSG_TRUNC means a fault

std::string reason(int error_number) {
  return std::strerror(error_number);
}

template <typename Value>
void set_option(int fd, int level, int name, const Value& value, const char* what) {
  if (setsockopt(fd, level, name, &value, sizeof value) != 0) {
    throw NetworkError(std::string("cannot set ") + what, errno);
  }
}

sockaddr_in to_sockaddr(const Endpoint& endpoint) {
  sockaddr_in out{};
  out.sin_family = AF_INET;
  out.sin_addr.s_addr = endpoint.address.network_order;
  out.sin_port = htons(endpoint.port);
  return out;
}

Endpoint from_sockaddr(const sockaddr_in& in) {
  return {{in.sin_addr.s_addr}, ntohs(in.sin_port)};
}

FileDescriptor open_udp() {
  FileDescriptor fd(socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (fd.get() < 0) {
    throw NetworkError("cannot open a UDP socket", errno);
  }
  return fd;
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

}  // namespace

NetworkError::NetworkError(const std::string& what, int error_number)
    : std::runtime_error(error_number == 0 ? what : what + ": " + reason(error_number)),
      error_number_(error_number) {}

bool operator==(Address a, Address b) {
  return a.network_order == b.network_order;
}
bool operator!=(Address a, Address b) {
  return !(a == b);
}

std::string to_string(Address address) {
  char text[INET_ADDRSTRLEN] = "";
  const in_addr in{address.network_order};
  inet_ntop(AF_INET, &in, text, sizeof text);
  return text;
}

bool operator==(const Endpoint& a, const Endpoint& b) {
  return a.address == b.address && a.port == b.port;
}

std::string to_string(const Endpoint& endpoint) {
  return to_string(endpoint.address) + ":" + std::to_string(endpoint.port);
}

bool is_well_formed_host(const std::string& text) {
  constexpr std::size_t kMaxName = 253;  // RFC 1035, as the 63 below
  static const std::regex labels(R"(([A-Za-z0-9_-]{1,63}\.)*[A-Za-z0-9_-]{1,63})");
  // A last label of digits only is an address with a mistake in it, such as 192.168.1.300.
  static const std::regex number(R"((.*\.)?[0-9]+)");
  return parse_address(text) ||
         (text.size() <= kMaxName && std::regex_match(text, labels) && !std::regex_match(text, number));
}

std::optional<Address> parse_address(const std::string& text) {
  in_addr numeric{};
  return inet_pton(AF_INET, text.c_str(), &numeric) == 1 ? std::make_optional(Address{numeric.s_addr})
                                                         : std::nullopt;
}

Address resolve(const std::string& name) {
  if (const std::optional<Address> numeric = parse_address(name)) {
    return *numeric;
  }
  addrinfo hints{};
  hints.ai_family = AF_INET;
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const int result = getaddrinfo(name.c_str(), nullptr, &hints, &found);
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> owner(found, &freeaddrinfo);
  if (result != 0 || found == nullptr) {
    throw NetworkError("cannot resolve '" + name + "' (" + gai_strerror(result) +
                           "): give it as a dotted quad or add it to /etc/hosts",
                       0);
  }
  sockaddr_in address;
  std::memcpy(&address, found->ai_addr, sizeof address);
  return {address.sin_addr.s_addr};
}

bool is_multicast(Address address) {
  return IN_MULTICAST(ntohl(address.network_order));
}

std::optional<Address> source_address_towards(Address destination) {
  // Connecting a UDP socket sends nothing; it only makes the kernel look up the route.
  const FileDescriptor fd = open_udp();
  const sockaddr_in to = to_sockaddr({destination, 9});
  sockaddr_in from{};
  socklen_t length = sizeof from;
  if (connect(fd.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0 ||
      getsockname(fd.get(), reinterpret_cast<sockaddr*>(&from), &length) != 0) {
    return std::nullopt;
  }
  return Address{from.sin_addr.s_addr};
}

std::vector<Address> broadcast_addresses(Address local) {
  std::vector<Address> out{{htonl(INADDR_BROADCAST)}};
  constexpr in_addr_t kLoopbackNet = 0x7f000000;
  constexpr in_addr_t kLoopbackMask = 0xff000000;
  if ((ntohl(local.network_order) & kLoopbackMask) == kLoopbackNet) {
    // Interfaces do not list it, but the kernel treats it as a broadcast, which a host on this very
    // machine hears.
    out.push_back({htonl(kLoopbackNet | ~kLoopbackMask)});
  }
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) {
    return out;
  }
  const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> owner(list, &freeifaddrs);
  for (const ifaddrs* i = list; i != nullptr; i = i->ifa_next) {
    const unsigned needed = IFF_UP | IFF_BROADCAST;
    if (i->ifa_addr == nullptr || i->ifa_addr->sa_family != AF_INET || (i->ifa_flags & needed) != needed ||
        i->ifa_broadaddr == nullptr) {
      continue;
    }
    sockaddr_in own;
    sockaddr_in broadcast;
    std::memcpy(&own, i->ifa_addr, sizeof own);
    std::memcpy(&broadcast, i->ifa_broadaddr, sizeof broadcast);
    if (local.any() || local.network_order == own.sin_addr.s_addr) {
      out.push_back({broadcast.sin_addr.s_addr});
    }
  }
  return out;
}

FileDescriptor::~FileDescriptor() {
  if (fd_ >= 0) {
    close(fd_);
  }
}

FileDescriptor::FileDescriptor(FileDescriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}

FileDescriptor& FileDescriptor::operator=(FileDescriptor&& other) noexcept {
  std::swap(fd_, other.fd_);
  return *this;
}

UdpSocket::UdpSocket(const Endpoint& local, Share share) : fd_(open_udp()), buffer_(kDatagramSpace) {
  const int on = 1;
  set_option(fd(), SOL_SOCKET, SO_BROADCAST, on, "SO_BROADCAST");
  set_option(fd(), SOL_SOCKET, SO_TIMESTAMPNS, on, "SO_TIMESTAMPNS");
  set_option(fd(), SOL_SOCKET, SO_RCVBUF, kReceiveBufferBytes, "SO_RCVBUF");
  if (share == Share::kYes) {
    set_option(fd(), SOL_SOCKET, SO_REUSEADDR, on, "SO_REUSEADDR");
  }
  // Without this a socket bound to INADDR_ANY hears every group that any program of the machine has joined.
  const int only_own_groups = 0;
  set_option(fd(), IPPROTO_IP, IP_MULTICAST_ALL, only_own_groups, "IP_MULTICAST_ALL");
  const sockaddr_in address = to_sockaddr(local);
  if (bind(fd(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    throw NetworkError("cannot bind UDP " + to_string(local), errno);
  }
}

Endpoint UdpSocket::local() const {
  sockaddr_in address{};
  socklen_t length = sizeof address;
  if (getsockname(fd(), reinterpret_cast<sockaddr*>(&address), &length) != 0) {
    throw NetworkError("cannot ask for the socket's own address", errno);
  }
  return from_sockaddr(address);
}

void UdpSocket::join(Address group, Address interface) {
  ip_mreqn request{};
  request.imr_multiaddr.s_addr = group.network_order;
  request.imr_address.s_addr = interface.network_order;
  if (setsockopt(fd(), IPPROTO_IP, IP_ADD_MEMBERSHIP, &request, sizeof request) != 0 && errno != EADDRINUSE) {
    throw NetworkError("cannot join group " + to_string(group) + " on interface " + to_string(interface),
                       errno);
  }
}

bool UdpSocket::receive(Datagram& datagram) {
  sockaddr_in source{};
  iovec space{buffer_.data(), buffer_.size()};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(timespec))];
  // An error that an earlier send provoked is reported here once and says nothing about waiting datagrams.
  for (int attempt = 0; attempt < 8; ++attempt) {
    msghdr header{};
    header.msg_name = &source;
    header.msg_namelen = sizeof source;
    header.msg_iov = &space;
    header.msg_iovlen = 1;
    header.msg_control = control;
    header.msg_controllen = sizeof control;
    const ssize_t size = recvmsg(fd(), &header, 0);
    if (size >= 0) {
      datagram.data = buffer_.data();
      datagram.size = static_cast<std::size_t>(size);
      datagram.truncated = (header.msg_flags & MSG_TRUNC) != 0;
      datagram.source = from_sockaddr(source);
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
  const sockaddr_in to = to_sockaddr(destination);
  ssize_t sent = -1;
  do {
    sent = sendto(fd(), packet.data(), packet.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof to);
  } while (sent < 0 && errno == EINTR);
  return sent == static_cast<ssize_t>(packet.size());
}

}  // namespace cortex_ros

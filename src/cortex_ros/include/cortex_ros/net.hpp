// UDP over IPv4 with owned file descriptors. Linux.
#pragma once

#include <netinet/in.h>

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "cortex_ros/clock.hpp"
#include "cortex_ros/protocol.hpp"

namespace cortex_ros {

// An operation of the network that failed; what() names operation, address and reason.
class NetworkError : public std::runtime_error {
 public:
  NetworkError(const std::string& what, int error_number);  // 0: `what` says it all
  int error_number() const { return error_number_; }

 private:
  int error_number_;
};

// IPv4 address, kept in network byte order because it is only stored, compared and handed to the kernel.
struct Address {
  in_addr_t network_order = INADDR_ANY;
  bool any() const { return network_order == htonl(INADDR_ANY); }
};
bool operator==(Address a, Address b);
bool operator!=(Address a, Address b);
std::string to_string(Address address);

struct Endpoint {
  Address address;
  std::uint16_t port = 0;
};
bool operator==(const Endpoint& a, const Endpoint& b);
std::string to_string(const Endpoint& endpoint);

// Whether the text can be an address at all: a dotted quad, or a well-formed host name, which need not exist.
bool is_well_formed_host(const std::string& text);

// A dotted quad only; empty for anything else.
std::optional<Address> parse_address(const std::string& text);

// Dotted quad or host name. Throws NetworkError when it does not resolve. A name may block in the resolver.
Address resolve(const std::string& name);

bool is_multicast(Address address);

// The own address from which the kernel would send to `destination`; empty when there is no route.
std::optional<Address> source_address_towards(Address destination);

// Where to send a packet that every host on the local networks shall hear: the limited broadcast address and
// the directed broadcast of each interface that is up (only of the interface that owns `local` when it is
// given).
std::vector<Address> broadcast_addresses(Address local);

class FileDescriptor {
 public:
  explicit FileDescriptor(int fd = -1) : fd_(fd) {}
  ~FileDescriptor();
  FileDescriptor(FileDescriptor&& other) noexcept;
  FileDescriptor& operator=(FileDescriptor&& other) noexcept;
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  int get() const { return fd_; }

 private:
  int fd_;
};

// One received datagram. `data` points into the socket's buffer and is good until the next receive().
struct Datagram {
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;
  bool truncated = false;
  Endpoint source;
  std::optional<Time> kernel_time;  // wall time at which the kernel took it from the network
};

// A non-blocking UDP socket with kernel receive time stamps and a large receive buffer.
class UdpSocket {
 public:
  enum class Share { kNo, kYes };  // kYes: SO_REUSEADDR, several processes may bind the same port

  UdpSocket(const Endpoint& local, Share share);  // throws NetworkError

  int fd() const { return fd_.get(); }
  Endpoint local() const;

  // Group membership on the interface that owns `interface` (INADDR_ANY: the kernel's route decides). Joining
  // again is harmless. Throws NetworkError.
  void join(Address group, Address interface);

  // False when nothing is waiting. Errors of the network that belong to no datagram are skipped.
  bool receive(Datagram& datagram);

  // False when the network refused it, with errno set. UDP promises nothing more anyway.
  bool send(const Bytes& packet, const Endpoint& destination);

 private:
  FileDescriptor fd_;
  std::vector<std::uint8_t> buffer_;
};

}  // namespace cortex_ros

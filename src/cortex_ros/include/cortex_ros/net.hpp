// UDP over IPv4. Linux.
#pragma once

#include <boost/asio/ip/udp.hpp>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "cortex_ros/clock.hpp"
#include "cortex_ros/protocol.hpp"

namespace cortex_ros {

using Address = boost::asio::ip::address_v4;
using Endpoint = boost::asio::ip::udp::endpoint;
// An operation of the network that failed; what() names operation, address and reason.
using NetworkError = boost::system::system_error;

std::string to_string(const Endpoint& endpoint);  // address:port

// Dotted quad or host name. Throws NetworkError when it does not resolve. A name may block in the resolver.
Address resolve(const std::string& name);

// The own address from which the kernel would send to `destination`; unspecified when there is no route.
Address source_address_towards(const Address& destination);

// Where to send a packet that every host on the local networks shall hear: the limited broadcast address and
// the directed broadcast of each interface that is up (only of the interface that owns `local` when it is
// given).
std::vector<Address> broadcast_addresses(const Address& local);

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

  int fd() { return socket_.native_handle(); }
  Endpoint local() const { return socket_.local_endpoint(); }

  // Group membership on the interface that owns `interface` (unspecified: the kernel's route decides).
  // Joining again is harmless. Throws NetworkError.
  void join(const Address& group, const Address& interface);

  // From now on the kernel refuses what does not come from `source`, before it takes room in the receive
  // buffer and time here; but one datagram in 1024, so that strangers can still be named. False when it
  // cannot.
  bool hear_only(const Address& source);
  void hear_all();

  // How many datagrams the kernel has not taken since the last call, or since hear_only(): strangers', and
  // what found the buffer full. 0 after hear_all().
  std::uint32_t newly_refused();

  // False when nothing is waiting. Errors of the network that belong to no datagram are skipped.
  bool receive(Datagram& datagram);

  // False when the network refused it. UDP promises nothing more anyway.
  bool send(const Bytes& packet, const Endpoint& destination);

 private:
  boost::asio::io_context context_;
  boost::asio::ip::udp::socket socket_{context_};
  std::vector<std::uint8_t> buffer_;
  std::optional<std::uint32_t> refused_;  // by the kernel so far; empty: it hears all
};

}  // namespace cortex_ros

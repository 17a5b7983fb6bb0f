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
// A network operation that failed; what() names operation, address and reason.
using NetworkError = boost::system::system_error;

std::string to_string(const Endpoint& endpoint);  // address:port

// Address of a dotted quad or host name. Throws NetworkError when it does not resolve. Resolving a name may
// block.
Address resolve(const std::string& name);

// The local address from which the kernel would send to `destination`; unspecified when there is no route.
Address source_address_towards(const Address& destination);

// Destinations that reach every host on the local networks: the limited broadcast address and the directed
// broadcast address of each interface that is up (only of the interface that owns `local` if that is given).
std::vector<Address> broadcast_addresses(const Address& local);

// One received datagram. `data` points into the socket's buffer and is valid until the next receive().
struct Datagram {
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;
  bool truncated = false;
  Endpoint source;
  std::optional<Time> kernel_time;  // wall time at which the kernel received it
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

  // From now on the kernel drops datagrams from other senders than `source`, before they take up the receive
  // buffer or our time; one in 1024 still gets through, so that their senders can be named. False when the
  // filter cannot be installed.
  bool hear_only(const Address& source);
  void hear_all();

  // Number of datagrams that the kernel has dropped since the last call, or since hear_only(): from other
  // senders, or because the buffer was full. 0 after hear_all().
  std::uint32_t newly_refused();

  // False when no datagram is waiting. Skips network errors that belong to no datagram.
  bool receive(Datagram& datagram);

  // False when the network refused it. True does not mean that it arrives (UDP).
  bool send(const Bytes& packet, const Endpoint& destination);

 private:
  boost::asio::io_context context_;
  boost::asio::ip::udp::socket socket_{context_};
  std::vector<std::uint8_t> buffer_;
  std::optional<std::uint32_t> refused_;  // datagrams dropped by the kernel so far; empty: no filter
};

}  // namespace cortex_ros

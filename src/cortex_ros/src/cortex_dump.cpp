// cortex_dump: packets of a Cortex host, or of a file, as JSON lines. Needs no ROS master.

#include <csignal>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <iterator>
#include <stdexcept>
#include <string>

#include "cortex_ros/client.hpp"
#include "cortex_ros/json.hpp"

namespace cortex_ros {
namespace {

const char kHelp[] = R"(usage: cortex_dump --host HOST [options]              frames of a running host
       cortex_dump --host HOST --bodies [options]     its body definitions, once
       cortex_dump --file PACKET.bin                  a recorded file (- is standard input)

Prints one JSON object per packet and line, in the units of the wire (marker positions usually in mm). "type" names
the packet; a frame has frame, delay_s (null: absent), bodies [{name, markers [[x, y, z] | null], segments, dofs}],
unidentified, analog, forces, items and faults (optional parts that were dropped). A lost marker is null.
A file may hold several packets one after the other. A malformed packet prints {"error": ...} and makes the exit code 1.

  --file PATH             read packets from PATH
  --bodies                print the body definitions of the host and exit
  --host HOST             the host's address or name; broadcast: ask every network of this computer
  --local-address ADDR    own address on the host's network  (default: the kernel's choice)
  --command-port PORT     the host's command port            (default 1510)
  --stream-group GROUP    multicast group of the stream      (default 225.1.1.1)
  --stream-port PORT      port of the stream                 (default 1001; below 1024 needs a privilege)
  --mode auto|stream|poll where frames come from             (default auto: the stream, else polling)
  --live                  send LiveMode to the host          (default: leave the host as it is)
  --count N               exit after N frames                (default: until interrupted)
  --timeout S             exit with code 1 when nothing came for S seconds  (default 5; 0 waits for ever)
  --help                  this text

exit codes: 0 done, 1 malformed packet or no answer, 2 wrong use
)";

constexpr int kExitFault = 1;
constexpr int kExitUsage = 2;

// Wrong use is an invalid_argument throughout, as the client's own.
using UsageError = std::invalid_argument;

struct Arguments {
  ClientOptions client;
  std::string file;
  bool help = false;
  bool bodies = false;
  std::uint64_t count = 0;  // 0: no limit
  double timeout_s = 5.0;
};

double to_number(const std::string& option, const std::string& text, double least, double most) {
  std::size_t used = 0;
  double value = 0.0;
  try {
    value = std::stod(text, &used);
  } catch (const std::logic_error&) {  // what stod throws for no number and for one out of range
    used = 0;
  }
  if (used == 0 || used != text.size() || !(value >= least && value <= most)) {
    throw UsageError(option + " needs a number from " + std::to_string(static_cast<long long>(least)) +
                     " to " + std::to_string(static_cast<long long>(most)) + ", not '" + text + "'");
  }
  return value;
}

std::uint16_t to_port(const std::string& option, const std::string& text) {
  return static_cast<std::uint16_t>(to_number(option, text, 1, 65535));
}

Arguments parse(int argc, char** argv) {
  Arguments arguments;
  ClientOptions& client = arguments.client;
  client.live_on_start = false;
  for (int i = 1; i < argc; ++i) {
    const std::string option = argv[i];
    const auto value = [&]() -> std::string {
      if (++i >= argc) {
        throw UsageError(option + " needs a value");
      }
      return argv[i];
    };
    if (option == "--help" || option == "-h") {
      arguments.help = true;
    } else if (option == "--bodies") {
      arguments.bodies = true;
    } else if (option == "--live") {
      client.live_on_start = true;
    } else if (option == "--file") {
      arguments.file = value();
    } else if (option == "--host") {
      client.host = value();
    } else if (option == "--local-address") {
      client.local_address = value();
    } else if (option == "--command-port") {
      client.command_port = to_port(option, value());
    } else if (option == "--stream-group") {
      client.stream_group = value();
    } else if (option == "--stream-port") {
      client.stream_port = to_port(option, value());
    } else if (option == "--mode") {
      client.mode = mode_from_text(value());
    } else if (option == "--count") {
      arguments.count = static_cast<std::uint64_t>(to_number(option, value(), 1, 1e15));
    } else if (option == "--timeout") {
      arguments.timeout_s = to_number(option, value(), 0, 1e6);
    } else {
      throw UsageError("unknown option '" + option + "'");
    }
  }
  if (!arguments.help && arguments.file.empty()) {
    client.host = host_from_text(client.host);
  }
  return arguments;
}

void print_line(const std::string& json) {
  std::cout << json << std::endl;
}

Bytes read_all(std::istream& in) {
  return Bytes(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
}

Bytes read_file(const std::string& path) {
  if (path == "-") {
    return read_all(std::cin);
  }
  std::ifstream in(path, std::ios::binary);
  try {
    if (in) {
      return read_all(in);
    }
  } catch (const std::ios_base::failure&) {
    // A folder, for one, opens but does not read: the same complaint.
  }
  throw ProtocolError("cannot read " + path);
}

// Prints the packet at the start of the bytes; returns its length, or 0 when nothing after it can be found.
std::size_t dump_first(const std::uint8_t* data, std::size_t size, bool& fault) {
  std::size_t length = 0;
  try {
    // A length beyond the end of the file leaves no way on; one inside it does, even when the content is bad.
    const std::size_t declared = declared_size(data, size);
    length = declared <= size ? declared : 0;
    print_line(to_json(decode(data, length == 0 ? size : length)));
  } catch (const ProtocolError& error) {
    fault = true;
    print_line(error_json(error.what()));
  }
  return length;
}

int dump_file(const std::string& path) {
  bool fault = false;
  try {
    const Bytes content = read_file(path);
    if (content.empty()) {
      throw ProtocolError(path + " is empty");
    }
    std::size_t at = 0;
    while (at < content.size()) {
      const std::size_t length = dump_first(content.data() + at, content.size() - at, fault);
      if (length == 0) {
        break;
      }
      at += length;
    }
  } catch (const ProtocolError& error) {
    fault = true;
    print_line(error_json(error.what()));
  }
  return fault ? kExitFault : 0;
}

class Dumper : public ClientEvents {
 public:
  explicit Dumper(const Arguments& arguments)
      : arguments_(arguments), client_(arguments.client, *this, clock_) {}

  int run() {
    while (!stopped_ && !finished()) {
      client_.step(std::chrono::milliseconds(50));
      if (timed_out()) {
        explain_silence();
        return kExitFault;
      }
    }
    return fault_ ? kExitFault : 0;
  }

  static void on_signal(int) { stopped_ = 1; }

 private:
  void on_frame(const ReceivedFrame& received) override {
    if (arguments_.bodies || finished()) {
      return;
    }
    print(to_json(received.frame));
    ++frames_;
  }

  void on_host_up(const HostInfo& info) override {
    std::cerr << "cortex_dump: host " << to_string(info.endpoint) << " '" << info.identity.name << "'"
              << std::endl;
    if (!arguments_.bodies) {
      return;
    }
    if (info.body_defs) {
      print(to_json(*info.body_defs));
      bodies_printed_ = true;
    } else {
      std::cerr << "cortex_dump: the host does not answer the request for body definitions" << std::endl;
    }
  }

  void on_comment(const std::string& text) override { print(to_json(Comment{text})); }

  void on_malformed(const std::string& what) override {
    fault_ = true;
    print(error_json(what));
  }

  void on_host_down(const std::string& why) override { std::cerr << "cortex_dump: " << why << std::endl; }
  void on_problem(const std::string& text) override { std::cerr << "cortex_dump: " << text << std::endl; }

  void explain_silence() const {
    const Statistics now = client_.statistics();
    std::cerr << "cortex_dump: nothing new from " << now.host << " for " << arguments_.timeout_s << " s: "
              << (now.host_up ? "the host is there but stands still (--live starts its live mode)"
                              : "is the host on, and are --host and the ports right?")
              << std::endl;
  }

  void print(const std::string& json) {
    print_line(json);
    last_output_ = clock_.monotonic();
  }

  bool finished() const { return bodies_printed_ || (arguments_.count > 0 && frames_ >= arguments_.count); }

  bool timed_out() const {
    return arguments_.timeout_s > 0.0 && to_seconds(clock_.monotonic() - last_output_) > arguments_.timeout_s;
  }

  static volatile std::sig_atomic_t stopped_;

  const Arguments& arguments_;
  const SystemClock clock_;
  Time last_output_ = clock_.monotonic();
  std::uint64_t frames_ = 0;
  bool bodies_printed_ = false;
  bool fault_ = false;
  Client client_;
};

volatile std::sig_atomic_t Dumper::stopped_ = 0;

int dump_host(const Arguments& arguments) {
  Dumper dumper(arguments);
  // The wait for packets is interrupted by the signal and then sees the flag, 50 ms later at worst.
  std::signal(SIGINT, Dumper::on_signal);
  std::signal(SIGTERM, Dumper::on_signal);
  return dumper.run();
}

int run(int argc, char** argv) {
  try {
    const Arguments arguments = parse(argc, argv);
    if (arguments.help) {
      std::cout << kHelp;
      return 0;
    }
    return arguments.file.empty() ? dump_host(arguments) : dump_file(arguments.file);
  } catch (const std::invalid_argument& error) {
    std::cerr << "cortex_dump: " << error.what() << " (--help tells more)" << std::endl;
    return kExitUsage;
  } catch (const std::exception& error) {
    std::cerr << "cortex_dump: " << error.what() << std::endl;
    return kExitFault;
  }
}

}  // namespace
}  // namespace cortex_ros

int main(int argc, char** argv) {
  return cortex_ros::run(argc, argv);
}

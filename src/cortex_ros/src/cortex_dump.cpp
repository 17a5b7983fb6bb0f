// cortex_dump: packets of a Cortex host, or of a file, as JSON lines. Needs no ROS master.

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <iterator>
#include <stdexcept>
#include <string>

#include "cortex_ros/client.hpp"
#include "cortex_ros/frame_sequence.hpp"
#include "cortex_ros/json.hpp"

namespace cortex_ros {
namespace {

constexpr char kDescription[] =
    R"(Prints packets of a Cortex host (--host) or of a file (--file): one JSON object per packet and line, in the units of
the wire (marker positions usually in mm). "type" names the packet; a frame has frame, delay_s (null: absent), bodies
[{name, markers [[x, y, z] | null], segments, dofs}], unidentified, analog, forces, items and faults (optional parts
that were dropped). A lost marker is null. A malformed packet prints {"error": ...} and makes the exit code 1.)";

constexpr int kExitFault = 1;
constexpr int kExitUsage = 2;

struct Arguments {
  ClientOptions client;
  std::string file;
  std::string mode = "auto";
  bool bodies = false;
  std::uint64_t count = 0;  // 0: no limit
  double timeout_s = 5.0;
};

void add_options(CLI::App& app, Arguments& arguments) {
  const CLI::Range port(1, 65535);
  ClientOptions& client = arguments.client;
  client.live_on_start = false;
  app.option_defaults()->always_capture_default();
  app.add_option("--file", arguments.file,
                 "read packets from a file, which may hold several one after the other; -: standard input");
  app.add_flag("--bodies", arguments.bodies, "print the body definitions of the host and exit");
  app.add_option("--host", client.host,
                 "the host's address or name; broadcast: ask every network of this computer");
  app.add_option("--local-address", client.local_address,
                 "own address on the host's network; empty: the kernel's choice");
  app.add_option("--command-port", client.command_port, "the host's command port")->check(port);
  app.add_option("--stream-group", client.stream_group, "multicast group of the stream");
  app.add_option("--stream-port", client.stream_port, "port of the stream; below 1024 it needs a privilege")
      ->check(port);
  app.add_option("--mode", arguments.mode,
                 "where frames come from: auto (the stream, else polling), stream, poll");
  app.add_flag("--live", client.live_on_start, "send LiveMode to the host, which is left as it is otherwise");
  app.add_option("--count", arguments.count, "exit after this many frames (0: when interrupted)")
      ->check(CLI::Range(1, 1000000000));
  app.add_option("--timeout", arguments.timeout_s,
                 "[s] exit with code 1 when nothing arrives for this long; 0: wait for ever")
      ->check(CLI::Range(0.0, 1e6));
  app.footer("exit codes: 0 done, 1 malformed packet or no answer, 2 wrong use");
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
    // A folder opens but cannot be read: the same error.
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
    const FrameOrder order = sequence_.classify(received.frame.frame);
    if (order == FrameOrder::kDuplicate || order == FrameOrder::kLate) {
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

  void on_host_down(const std::string& why) override {
    sequence_.reset();
    std::cerr << "cortex_dump: " << why << std::endl;
  }
  void on_problem(const std::string& text) override { std::cerr << "cortex_dump: " << text << std::endl; }

  void explain_silence() const {
    const Statistics now = client_.statistics();
    std::cerr << "cortex_dump: nothing new from " << now.host << " for " << arguments_.timeout_s << " s: "
              << (now.host_up ? "the host answers, but sends no new frames (--live starts its live mode)"
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

  static inline volatile std::sig_atomic_t stopped_ = 0;

  const Arguments& arguments_;
  const SystemClock clock_;
  Time last_output_ = clock_.monotonic();
  FrameSequence sequence_;
  std::uint64_t frames_ = 0;
  bool bodies_printed_ = false;
  bool fault_ = false;
  Client client_;
};

int dump_host(const Arguments& arguments) {
  Dumper dumper(arguments);
  // The wait for packets is interrupted by the signal and then sees the flag, 50 ms later at worst.
  std::signal(SIGINT, Dumper::on_signal);
  std::signal(SIGTERM, Dumper::on_signal);
  return dumper.run();
}

int run(int argc, char** argv) {
  CLI::App app(kDescription, "cortex_dump");
  Arguments arguments;
  add_options(app, arguments);
  try {
    app.parse(argc, argv);
    if (!arguments.file.empty()) {
      return dump_file(arguments.file);
    }
    arguments.client.host = host_from_text(arguments.client.host);
    arguments.client.mode = mode_from_text(arguments.mode);
    return dump_host(arguments);
  } catch (const CLI::CallForHelp&) {
    std::cout << app.help();
    return 0;
  } catch (const CLI::ParseError& error) {
    std::cerr << "cortex_dump: " << error.what() << " (--help tells more)" << std::endl;
    return kExitUsage;
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

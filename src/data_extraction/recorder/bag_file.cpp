#include "bag_file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <numeric>
#include <system_error>
#include <type_traits>

namespace data_extraction {
namespace {

constexpr std::string_view kMagic = "#ROSBAG V2.0\n";
constexpr std::size_t kFileHeaderBytes = 4096;  // padded, so that the finished one fits in its place
constexpr std::size_t kBytesOfIndexEntry = 12;  // time and place of a message
constexpr std::size_t kMostChunksGivenUp = 8;   // to make room for the index, which is smaller than one
constexpr std::uint32_t kIndexVersion = 1;

enum class Op : std::uint8_t {
  message = 2,
  file_header = 3,
  index = 4,
  chunk = 5,
  chunk_info = 6,
  connection = 7
};

// The bytes of a number. ROS knows little-endian computers only.
template <typename T>
std::string_view raw(const T& value) {
  static_assert(std::is_arithmetic_v<T> || std::is_enum_v<T>);
  return {reinterpret_cast<const char*>(&value), sizeof value};
}

std::uint32_t length(std::string_view bytes) {
  return static_cast<std::uint32_t>(bytes.size());
}

std::uint64_t time_field(ros::Time time) {
  return std::uint64_t{time.nsec} << 32 | time.sec;
}

// Fields of a record or of a connection: length, name=value, one after the other.
class Fields {
 public:
  Fields() = default;
  explicit Fields(Op op) { add("op", raw(op)); }
  Fields& add(std::string_view name, std::string_view value) {
    bytes_.append(raw(static_cast<std::uint32_t>(name.size() + 1 + value.size())));
    bytes_.append(name).append(1, '=').append(value);
    return *this;
  }
  operator const std::string&() const { return bytes_; }

 private:
  std::string bytes_;
};

void put_record(std::string& to, const std::string& header, std::string_view data) {
  to.append(raw(length(header))).append(header).append(raw(length(data))).append(data);
}

std::string file_header(std::uint64_t index_position, std::size_t connections, std::size_t chunks) {
  const std::string fields = Fields(Op::file_header)
                                 .add("index_pos", raw(index_position))
                                 .add("conn_count", raw(static_cast<std::uint32_t>(connections)))
                                 .add("chunk_count", raw(static_cast<std::uint32_t>(chunks)));
  std::string record;
  put_record(record, fields, std::string(kFileHeaderBytes - length(fields), ' '));
  return record;
}

[[noreturn]] void throw_last_error() {
  throw std::system_error(errno, std::generic_category());
}

bool is_lack_of_room(const std::system_error& error) {
  return error.code().value() == ENOSPC || error.code().value() == EDQUOT || error.code().value() == EFBIG;
}

}  // namespace

void Chunk::add_connection(std::uint32_t id, const std::string& topic, const ros::M_string& header) {
  Fields connection;
  for (const auto& [name, value] : header) {
    connection.add(name, value);
  }
  std::string record;
  put_record(record, Fields(Op::connection).add("conn", raw(id)).add("topic", topic),
             std::string(connection));
  records_ += record;
  connections_.push_back(std::move(record));
}

void Chunk::add_message(std::uint32_t connection, ros::Time received, std::string_view message) {
  const std::uint64_t time = time_field(received);
  if (index_.size() <= connection) {
    index_.resize(connection + 1);
  }
  index_[connection].append(raw(time)).append(raw(length(records_)));
  put_record(records_, Fields(Op::message).add("conn", raw(connection)).add("time", raw(time)), message);
  first_ = messages_ == 0 ? received : std::min(first_, received);
  last_ = messages_ == 0 ? received : std::max(last_, received);
  ++messages_;
}

std::size_t Chunk::bytes() const {
  return records_.size() + messages_ * kBytesOfIndexEntry;
}

BagFile::BagFile(const std::string& path)
    : file_(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666)) {
  if (file_ < 0) {
    throw std::system_error(errno, std::generic_category(), path);
  }
  ::flock(file_, LOCK_EX);  // tells another recorder that this one is alive
  try {
    const std::string header = file_header(0, 0, 0);
    write_at(0, kMagic);
    write_at(kMagic.size(), header);
    end_ = kMagic.size() + header.size();
  } catch (const std::system_error& error) {
    ::close(file_);
    ::unlink(path.c_str());
    throw std::system_error(error.code(), path);
  }
}

BagFile::~BagFile() {
  ::close(file_);
}

void BagFile::write(const Chunk& chunk) {
  const std::string fields =
      Fields(Op::chunk).add("compression", "none").add("size", raw(length(chunk.records_)));
  std::string before, after, counts;
  before.append(raw(length(fields))).append(fields).append(raw(length(chunk.records_)));
  std::uint32_t connections = 0;
  for (std::uint32_t id = 0; id < chunk.index_.size(); ++id) {
    const std::string& entries = chunk.index_[id];
    if (entries.empty()) {
      continue;
    }
    const auto count = static_cast<std::uint32_t>(entries.size() / kBytesOfIndexEntry);
    put_record(after,
               Fields(Op::index).add("ver", raw(kIndexVersion)).add("conn", raw(id)).add("count", raw(count)),
               entries);
    counts.append(raw(id)).append(raw(count));
    ++connections;
  }
  Written written{end_, {}, connections_.size() + chunk.connections_.size(), chunk.messages_};
  put_record(written.info,
             Fields(Op::chunk_info)
                 .add("ver", raw(kIndexVersion))
                 .add("chunk_pos", raw(end_))
                 .add("start_time", raw(time_field(chunk.first_)))
                 .add("end_time", raw(time_field(chunk.last_)))
                 .add("count", raw(connections)),
             counts);
  try {
    write_at(end_, before);
    write_at(end_ + before.size(), chunk.records_);
    write_at(end_ + before.size() + chunk.records_.size(), after);
  } catch (const std::system_error&) {
    cut_off_at_end();
    throw;
  }
  end_ += before.size() + chunk.records_.size() + after.size();
  chunks_.push_back(std::move(written));
  connections_.insert(connections_.end(), chunk.connections_.begin(), chunk.connections_.end());
}

void BagFile::finish() {
  for (std::size_t given_up = 0;; ++given_up) {
    std::string index;
    for (const std::string& connection : connections_) {
      index += connection;
    }
    for (const Written& chunk : chunks_) {
      index += chunk.info;
    }
    try {
      write_at(end_, index);
      write_at(kMagic.size(), file_header(end_, connections_.size(), chunks_.size()));
      return;
    } catch (const std::system_error& error) {
      if (!is_lack_of_room(error) || chunks_.empty() || given_up == kMostChunksGivenUp) {
        throw;
      }
    }
    end_ = chunks_.back().position;
    chunks_.pop_back();
    connections_.resize(chunks_.empty() ? 0 : chunks_.back().connections);
    cut_off_at_end();
  }
}

std::size_t BagFile::messages() const {
  return std::accumulate(chunks_.begin(), chunks_.end(), std::size_t{0},
                         [](std::size_t sum, const Written& chunk) { return sum + chunk.messages; });
}

void BagFile::write_at(std::uint64_t position, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::pwrite(file_, bytes.data(), bytes.size(), static_cast<off_t>(position));
    if (written >= 0) {
      position += static_cast<std::uint64_t>(written);
      bytes.remove_prefix(static_cast<std::size_t>(written));
    } else if (errno != EINTR) {
      throw_last_error();
    }
  }
}

void BagFile::cut_off_at_end() {
  if (::ftruncate(file_, static_cast<off_t>(end_)) != 0) {
    return;  // what stays behind the end is in nobody's way, but for the room that it takes
  }
}

}  // namespace data_extraction

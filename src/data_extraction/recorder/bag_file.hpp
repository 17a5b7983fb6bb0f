// A ROS bag of format 2.0 (http://wiki.ros.org/Bags/Format/2.0), made chunk by chunk.
//
// rosbag::Bag is unusable once the disk was full: half a message stays in the chunk, closing fails too, and
// its destructor throws, which ends the process. Here a chunk grows in memory and is written whole or not at
// all, so what the bag holds can always be indexed and read. This also takes one system call per chunk, where
// rosbag::Bag takes several per message.

#pragma once

#include <fcntl.h>
#include <ros/datatypes.h>
#include <ros/time.h>
#include <rosbag/constants.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <map>
#include <string>
#include <string_view>
#include <system_error>
#include <type_traits>
#include <utility>
#include <vector>

namespace data_extraction {

// The bytes of a number. ROS supports little-endian computers only.
template <typename T>
std::string_view raw(const T& value) {
  static_assert(std::is_arithmetic_v<T>);
  return {reinterpret_cast<const char*>(&value), sizeof value};
}

inline void put_length(std::string& to, std::size_t length) {
  to.append(raw(static_cast<std::uint32_t>(length)));
}

inline std::uint64_t time_field(ros::Time time) {
  return std::uint64_t{time.nsec} << 32 | time.sec;
}

inline void put_field(std::string& to, std::string_view name, std::string_view value) {
  put_length(to, name.size() + 1 + value.size());
  to.append(name).append(1, rosbag::FIELD_DELIM).append(value);
}

// Appends a record without its data, which are `bytes` long. Returns the string, to append them.
inline std::string& put_record(std::string& to, unsigned char op,
                               std::initializer_list<std::pair<std::string_view, std::string_view>> fields,
                               std::size_t bytes) {
  const std::size_t begin = to.size();
  put_length(to, 0);
  put_field(to, "op", raw(op));
  for (const auto& [name, value] : fields) {
    put_field(to, name, value);
  }
  const auto length = static_cast<std::uint32_t>(to.size() - begin - sizeof(std::uint32_t));
  to.replace(begin, sizeof length, raw(length));
  put_length(to, bytes);
  return to;
}

// Messages, the connections that are new with them, and their index, laid out as in a bag.
class Chunk {
 public:
  // Bytes that a message takes in memory and in the bag besides its content: header, 2 lengths, index entry.
  static constexpr std::size_t kBytesAround = 58;

  // Connections of a bag are numbered from 0 in the order in which they are added to its chunks.
  void add_connection(std::uint32_t id, const std::string& topic, const ros::M_string& header) {
    std::string record, fields;
    for (const auto& [name, value] : header) {
      put_field(fields, name, value);
    }
    put_record(record, rosbag::OP_CONNECTION, {{"conn", raw(id)}, {"topic", topic}}, fields.size()) += fields;
    records_ += connections_.emplace_back(std::move(record));
  }

  void add_message(std::uint32_t connection, ros::Time received, std::string_view message) {
    const std::uint64_t time = time_field(received);
    std::string& index = index_[connection];
    put_length(index.append(raw(time)), records_.size());
    put_record(records_, rosbag::OP_MSG_DATA, {{"conn", raw(connection)}, {"time", raw(time)}},
               message.size()) += message;
    first_ = std::min(first_, received);
    last_ = std::max(last_, received);
    ++messages_;
  }

  std::size_t messages() const { return messages_; }
  std::size_t bytes() const { return records_.size() + messages_ * kBytesOfIndexEntry; }

 private:
  friend class BagFile;
  static constexpr std::size_t kBytesOfIndexEntry = 12;  // time and place of a message

  std::string records_;
  std::vector<std::string> connections_;        // records of those that are new in this chunk
  std::map<std::uint32_t, std::string> index_;  // by connection: time and place of each message
  std::size_t messages_ = 0;
  ros::Time first_ = ros::TIME_MAX, last_;
};

class BagFile {
 public:
  // Begins a bag of this name, which must be new. Throws std::system_error.
  explicit BagFile(const std::string& path)
      : file_(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666)) {
    if (file_ < 0) {
      throw std::system_error(errno, std::generic_category(), path);
    }
    ::flock(file_, LOCK_EX);  // tells another recorder that this one is alive
    try {
      end_ = write_header();
    } catch (const std::system_error& error) {
      ::close(file_);
      ::unlink(path.c_str());
      throw std::system_error(error.code(), path);
    }
  }
  ~BagFile() { ::close(file_); }
  BagFile(const BagFile&) = delete;
  BagFile& operator=(const BagFile&) = delete;

  // Whether a running process is writing a bag of this name.
  static bool is_being_written(const std::string& path) {
    const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    const bool taken = file >= 0 && ::flock(file, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    ::close(file);
    return taken;
  }

  // Throws std::system_error; the bag then holds the chunks before this one.
  void write(const Chunk& chunk) {
    std::string bytes, counts;
    const auto size = static_cast<std::uint32_t>(chunk.records_.size());
    put_record(bytes, rosbag::OP_CHUNK, {{"compression", "none"}, {"size", raw(size)}}, size) +=
        chunk.records_;
    for (const auto& [id, entries] : chunk.index_) {
      const auto count = static_cast<std::uint32_t>(entries.size() / Chunk::kBytesOfIndexEntry);
      put_record(bytes, rosbag::OP_INDEX_DATA,
                 {{"ver", raw(rosbag::INDEX_VERSION)}, {"conn", raw(id)}, {"count", raw(count)}},
                 entries.size()) += entries;
      counts.append(raw(id)).append(raw(count));
    }
    Written written{end_, {}, connections_.size(), chunk.messages_};
    put_record(written.info, rosbag::OP_CHUNK_INFO,
               {{"ver", raw(rosbag::CHUNK_INFO_VERSION)},
                {"chunk_pos", raw(end_)},
                {"start_time", raw(time_field(chunk.first_))},
                {"end_time", raw(time_field(chunk.last_))},
                {"count", raw(static_cast<std::uint32_t>(chunk.index_.size()))}},
               counts.size()) += counts;
    try {
      write_at(end_, bytes);
    } catch (const std::system_error&) {
      cut_off_at_end();
      throw;
    }
    end_ += bytes.size();
    messages_ += chunk.messages_;
    chunks_.push_back(std::move(written));
    connections_.insert(connections_.end(), chunk.connections_.begin(), chunk.connections_.end());
  }

  // Writes the index, which makes the bag readable. If there is no room for the index, drops the last chunks,
  // at most `may_be_given_up` of them; each is larger than the index. Throws std::system_error; the chunks
  // then stay in the file, and `rosbag reindex` finds them.
  void finish(int may_be_given_up = 8) try {
    std::string index;
    for (const std::string& connection : connections_) {
      index += connection;
    }
    for (const Written& chunk : chunks_) {
      index += chunk.info;
    }
    write_at(end_, index);
    write_header();
  } catch (const std::system_error& error) {
    const int code = error.code().value();
    const bool lacks_room = code == ENOSPC || code == EDQUOT || code == EFBIG;
    if (!lacks_room || chunks_.empty() || may_be_given_up == 0) {
      throw;
    }
    end_ = chunks_.back().position;
    messages_ -= chunks_.back().messages;
    connections_.resize(chunks_.back().connections);
    chunks_.pop_back();
    cut_off_at_end();
    finish(may_be_given_up - 1);
  }

  std::size_t messages() const { return messages_; }
  std::uint64_t bytes() const { return end_; }

 private:
  struct Written {
    std::uint64_t position;
    std::string info;         // its record in the index of the bag
    std::size_t connections;  // of the bag, before this chunk
    std::size_t messages;
  };

  // Padded, so that the header of the finished bag fits in the place of the first one. Returns where it ends.
  std::size_t write_header() {
    constexpr std::size_t kPadding = rosbag::FILE_HEADER_LENGTH - 69;  // less the fields
    std::string bytes = "#ROSBAG V2.0\n";
    put_record(bytes, rosbag::OP_FILE_HEADER,
               {{"index_pos", raw(end_)},
                {"conn_count", raw(static_cast<std::uint32_t>(connections_.size()))},
                {"chunk_count", raw(static_cast<std::uint32_t>(chunks_.size()))}},
               kPadding)
        .append(kPadding, ' ');
    write_at(0, bytes);
    return bytes.size();
  }

  void write_at(std::uint64_t position, std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t written = ::pwrite(file_, bytes.data(), bytes.size(), static_cast<off_t>(position));
      if (written >= 0) {
        position += static_cast<std::uint64_t>(written);
        bytes.remove_prefix(static_cast<std::size_t>(written));
      } else if (errno != EINTR) {
        throw std::system_error(errno, std::generic_category());
      }
    }
  }

  void cut_off_at_end() {
    if (::ftruncate(file_, static_cast<off_t>(end_)) != 0) {
      return;  // bytes beyond the end do no harm, except for the space that they take
    }
  }

  const int file_;
  std::uint64_t end_ = 0;  // of the last chunk
  std::size_t messages_ = 0;
  std::vector<std::string> connections_;
  std::vector<Written> chunks_;
};

}  // namespace data_extraction

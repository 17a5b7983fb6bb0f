// A ROS bag of format 2.0 (http://wiki.ros.org/Bags/Format/2.0), made chunk by chunk.
//
// rosbag::Bag cannot be used any more once the disk was full: half a message stays in the chunk, closing
// fails too, and its destructor throws, which ends the process. Here a chunk grows in memory and is written
// whole or not at all, so what the bag holds can be indexed and read whatever happened. It also takes three
// system calls a chunk where rosbag::Bag takes some for every message.

#pragma once

#include <ros/datatypes.h>
#include <ros/time.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace data_extraction {

// Messages, the connections that they are the first of, and their index, as they lie in a bag.
class Chunk {
 public:
  // What a message takes in memory and in the bag besides itself: header, two lengths, entry in the index.
  static constexpr std::size_t kBytesAround = 58;

  // Connections of a bag are numbered from 0 in the order in which they are added to its chunks.
  void add_connection(std::uint32_t id, const std::string& topic, const ros::M_string& header);
  void add_message(std::uint32_t connection, ros::Time received, std::string_view message);

  std::size_t messages() const { return messages_; }
  std::size_t bytes() const;

 private:
  friend class BagFile;

  std::string records_;
  std::vector<std::string> connections_;  // records of those that are new in this chunk
  std::vector<std::string> index_;        // by connection: time and place of each message
  std::size_t messages_ = 0;
  ros::Time first_, last_;
};

class BagFile {
 public:
  // Begins a bag of this name, which must be new. Throws std::system_error.
  explicit BagFile(const std::string& path);
  ~BagFile();
  BagFile(const BagFile&) = delete;
  BagFile& operator=(const BagFile&) = delete;

  // Throws std::system_error; the bag holds the chunks before this one then.
  void write(const Chunk& chunk);

  // Writes the index: now it can be read. Where there is no room for it, the last chunks make room. Throws
  // std::system_error; the chunks stay in the file then, and `rosbag reindex` finds them.
  void finish();

  std::size_t messages() const;
  std::uint64_t bytes() const { return end_; }

 private:
  struct Written {
    std::uint64_t position;
    std::string info;         // its record in the index of the bag
    std::size_t connections;  // of the bag, up to this chunk
    std::size_t messages;
  };

  void write_at(std::uint64_t position, std::string_view bytes);
  void cut_off_at_end();

  const int file_;
  std::uint64_t end_ = 0;  // of the last chunk
  std::vector<std::string> connections_;
  std::vector<Written> chunks_;
};

}  // namespace data_extraction

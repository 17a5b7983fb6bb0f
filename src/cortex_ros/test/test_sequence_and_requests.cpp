// Frame numbers, and requests one at a time: neither reads a clock, so the tests pass in the time.

#include <gtest/gtest.h>

#include <limits>
#include <string>
#include <vector>

#include "cortex_ros/frame_sequence.hpp"
#include "cortex_ros/request_queue.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using std::chrono::milliseconds;

TEST(FrameSequence, CountsUpAndSeesGaps) {
  FrameSequence sequence;
  EXPECT_EQ(sequence.classify(100), FrameOrder::kNew);
  EXPECT_EQ(sequence.gap(), 0);
  EXPECT_EQ(sequence.classify(101), FrameOrder::kNew);
  EXPECT_EQ(sequence.gap(), 0);
  EXPECT_EQ(sequence.classify(105), FrameOrder::kNew);
  EXPECT_EQ(sequence.gap(), 3);
  EXPECT_EQ(sequence.classify(105), FrameOrder::kDuplicate);
  EXPECT_EQ(sequence.gap(), 0);
}

TEST(FrameSequence, OvertakenFrameIsLate) {
  FrameSequence sequence;
  sequence.classify(100);
  sequence.classify(102);
  EXPECT_EQ(sequence.classify(101), FrameOrder::kLate);
  EXPECT_EQ(sequence.classify(103), FrameOrder::kNew);
  EXPECT_EQ(sequence.gap(), 0);
}

TEST(FrameSequence, SmallerNumberIsARestart) {
  FrameSequence sequence;
  sequence.classify(1000);
  EXPECT_EQ(sequence.classify(1), FrameOrder::kRestart);
  EXPECT_EQ(sequence.classify(2), FrameOrder::kNew);
  EXPECT_EQ(sequence.gap(), 0);
}

TEST(FrameSequence, RestartNextToTheOldNumberIsSeenAfterAFewFrames) {
  FrameSequence sequence;
  sequence.classify(5);
  EXPECT_EQ(sequence.classify(0), FrameOrder::kLate);
  EXPECT_EQ(sequence.classify(1), FrameOrder::kLate);
  EXPECT_EQ(sequence.classify(2), FrameOrder::kRestart);
  EXPECT_EQ(sequence.classify(3), FrameOrder::kNew);
}

TEST(FrameSequence, JumpsAreNoLosses) {
  FrameSequence sequence;
  sequence.classify(std::numeric_limits<std::int32_t>::min());
  EXPECT_EQ(sequence.classify(std::numeric_limits<std::int32_t>::max()), FrameOrder::kRestart);
  EXPECT_EQ(sequence.gap(), 0);
  EXPECT_EQ(sequence.classify(std::numeric_limits<std::int32_t>::min()), FrameOrder::kRestart);
}

// Logs the outcomes of the requests.
class RequestQueueTest : public testing::Test {
 protected:
  static Packet reply(const std::string& payload) {
    return GeneralReply{Bytes(payload.begin(), payload.end())};
  }
  static std::string text_of(const std::optional<Bytes>& packet) {
    return packet ? std::string(packet->begin() + kHeaderBytes, packet->end() - 1) : "nothing";
  }

  void ask(const std::string& text) {
    queue_.push(RequestQueue::Kind::kText, encode_text_request(text), [this, text](const Packet* answer) {
      const auto* reply = answer == nullptr ? nullptr : std::get_if<GeneralReply>(answer);
      log_.push_back(text + "=" +
                     (answer == nullptr  ? "silence"
                      : reply == nullptr ? "other"
                                         : std::string(reply->payload.begin(), reply->payload.end())));
    });
  }

  void ask_for_bodies() {
    queue_.push(RequestQueue::Kind::kBodyDefs, encode_request(Command::kRequestBodyDefs),
                [this](const Packet* answer) { log_.push_back(answer ? "answer" : "silence"); });
  }

  RequestQueue queue_{milliseconds(250), 3};
  std::vector<std::string> log_;
};

TEST_F(RequestQueueTest, GoOutOneAtATime) {
  ask("A");
  ask("B");
  EXPECT_EQ(text_of(queue_.update(milliseconds(0))), "A");
  EXPECT_EQ(text_of(queue_.update(milliseconds(100))), "nothing");
  EXPECT_TRUE(queue_.offer(reply("a"), milliseconds(110)));
  EXPECT_EQ(text_of(queue_.update(milliseconds(110))), "nothing") << "duplicates may follow";
  EXPECT_EQ(queue_.next_event(), Time(milliseconds(130)));
  EXPECT_EQ(text_of(queue_.update(milliseconds(130))), "B");
  EXPECT_TRUE(queue_.offer(reply("b"), milliseconds(140)));
  EXPECT_EQ(log_, (std::vector<std::string>{"A=a", "B=b"}));
  EXPECT_TRUE(queue_.idle());
}

TEST_F(RequestQueueTest, DuplicateAnswerIsNotTheNextOnes) {
  ask("A");
  ask("B");
  queue_.update(milliseconds(0));
  EXPECT_TRUE(queue_.offer(reply("a"), milliseconds(1)));
  EXPECT_FALSE(queue_.offer(reply("a"), milliseconds(5)));
  queue_.update(milliseconds(30));
  EXPECT_TRUE(queue_.offer(reply("b"), milliseconds(31)));
  EXPECT_EQ(log_, (std::vector<std::string>{"A=a", "B=b"}));
}

TEST_F(RequestQueueTest, SilenceIsRepeatedThenReported) {
  ask("A");
  EXPECT_EQ(text_of(queue_.update(milliseconds(0))), "A");
  EXPECT_EQ(queue_.next_event(), Time(milliseconds(250)));
  EXPECT_EQ(text_of(queue_.update(milliseconds(250))), "A");
  EXPECT_EQ(text_of(queue_.update(milliseconds(500))), "A");
  EXPECT_EQ(text_of(queue_.update(milliseconds(750))), "nothing");
  EXPECT_EQ(log_, (std::vector<std::string>{"A=silence"}));
}

// Answers take 300 ms, longer than the time-out: each request is sent twice and answered twice.
TEST_F(RequestQueueTest, LateAnswersAreNotTheNextOnes) {
  ask("A");
  ask("B");
  EXPECT_EQ(text_of(queue_.update(milliseconds(0))), "A");
  EXPECT_EQ(text_of(queue_.update(milliseconds(250))), "A");
  EXPECT_TRUE(queue_.offer(reply("a"), milliseconds(300)));
  EXPECT_FALSE(queue_.offer(reply("a"), milliseconds(301))) << "a duplicate on top";
  EXPECT_EQ(text_of(queue_.update(milliseconds(330))), "nothing") << "the repeat will be answered too";
  EXPECT_FALSE(queue_.offer(reply("a"), milliseconds(550)));
  EXPECT_EQ(text_of(queue_.update(milliseconds(569))), "nothing");
  EXPECT_EQ(text_of(queue_.update(milliseconds(570))), "B");
  EXPECT_TRUE(queue_.offer(reply("b"), milliseconds(580)));
  EXPECT_EQ(log_, (std::vector<std::string>{"A=a", "B=b"}));
}

TEST_F(RequestQueueTest, AfterSilenceTheNextOneWaitsForALateAnswer) {
  queue_ = RequestQueue(milliseconds(250), 1);
  ask("A");
  ask("B");
  EXPECT_EQ(text_of(queue_.update(milliseconds(0))), "A");
  EXPECT_EQ(text_of(queue_.update(milliseconds(250))), "nothing");
  EXPECT_EQ(text_of(queue_.update(milliseconds(519))), "nothing");
  EXPECT_EQ(text_of(queue_.update(milliseconds(520))), "B");
}

TEST_F(RequestQueueTest, AnswersOfAnotherTypeAreNotTaken) {
  ask("A");
  queue_.update(milliseconds(0));
  for (const Packet& packet :
       {Packet(FrameOfData()), Packet(BodyDefs()), Packet(Comment{"x"}), Packet(HereIAm())}) {
    EXPECT_FALSE(queue_.offer(packet, milliseconds(1)));
  }
  EXPECT_TRUE(queue_.offer(UnrecognizedRequest(), milliseconds(2)));
  EXPECT_EQ(log_, (std::vector<std::string>{"A=other"}));

  ask_for_bodies();
  EXPECT_TRUE(queue_.update(milliseconds(3)).has_value()) << "another kind of request need not wait";
  EXPECT_FALSE(queue_.offer(reply("a"), milliseconds(4)));
  EXPECT_TRUE(queue_.offer(BodyDefs(), milliseconds(5)));
}

TEST_F(RequestQueueTest, UnrecognizedCommandAnswersAnything) {
  ask_for_bodies();
  queue_.update(milliseconds(0));
  EXPECT_TRUE(queue_.offer(UnrecognizedCommand(), milliseconds(1)));
  EXPECT_EQ(log_, (std::vector<std::string>{"answer"}));
}

TEST_F(RequestQueueTest, AnswersToClearedOnesAreNotTheNextOnes) {
  ask("A");
  queue_.update(milliseconds(0));
  queue_.clear();
  EXPECT_TRUE(queue_.idle());
  ask("B");
  EXPECT_EQ(text_of(queue_.update(milliseconds(10))), "nothing");
  EXPECT_FALSE(queue_.offer(reply("a"), milliseconds(20)));
  EXPECT_EQ(text_of(queue_.update(milliseconds(250))), "B");
  EXPECT_TRUE(log_.empty());
}

TEST_F(RequestQueueTest, MayBePushedFromAnAnswer) {
  queue_.push(RequestQueue::Kind::kText, encode_text_request("A"), [this](const Packet*) { ask("B"); });
  queue_.update(milliseconds(0));
  queue_.offer(reply("a"), milliseconds(1));
  EXPECT_EQ(text_of(queue_.update(milliseconds(50))), "B");
}

}  // namespace

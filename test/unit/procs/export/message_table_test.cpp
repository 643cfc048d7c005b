#include "export/message_table.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

namespace gastronaut {
namespace {

using testing::HasSubstr;
using testing::Not;

// Header and rows of the messages, as lines.
template <class Message>
std::vector<std::string> table_of(const std::vector<Message>& messages) {
  MessageTable table(WireLayoutOf<Message>::value);
  for (const Message& message : messages) table.measure(encode_message(message));
  std::vector<std::string> lines = {table.header()};
  for (const Message& message : messages) lines.push_back(table.row(encode_message(message)));
  return lines;
}

TEST(MessageTable, GivesEachNumberAColumn) {
  rigid_transform_t message{};
  message.utime = 1234567890123456;
  message.trans[1] = -0.1;
  message.trans[2] = std::numeric_limits<double>::quiet_NaN();
  message.quat[0] = 1;
  EXPECT_THAT(table_of<rigid_transform_t>({message}),
              testing::ElementsAre("utime,trans_0,trans_1,trans_2,quat_0,quat_1,quat_2,quat_3",
                                   "1234567890123456,0,-0.1,nan,1,0,0,0"));
}

TEST(MessageTable, ShorterArraysLeaveCellsEmpty) {
  hall_array_t two{};
  two.num_sensors = 2;
  two.num_axes = 2;
  two.field = {{1, 2}, {3, 4}};
  two.status = {-1, 4};
  hall_array_t one{};
  one.num_sensors = 1;
  one.num_axes = 3;
  one.field = {{5, 6, 7}};
  one.status = {2};
  EXPECT_THAT(table_of<hall_array_t>({two, one}),
              testing::ElementsAre("utime,seq,num_sensors,num_axes,field_0_0,field_0_1,field_0_2,"
                                   "field_1_0,field_1_1,field_1_2,status_0,status_1",
                                   "0,0,2,2,1,2,,3,4,,-1,4", "0,0,1,3,5,6,7,,,,2,"));
}

TEST(MessageTable, StructsWithinAndWordsAreColumnsToo) {
  capsule_state_t state{};
  sensor_health_t health{};
  health.name = "visual";
  health.p_nominal = 0.25;
  health.used = true;
  health.cause = "blur, \"they\" say";
  state.sensors = {health};
  state.num_sensors = 1;
  capsule_state_t none{};
  const std::vector<std::string> lines = table_of<capsule_state_t>({state, none});
  EXPECT_THAT(lines[0], testing::EndsWith(",num_sensors,sensors_0_name,sensors_0_p_nominal,"
                                          "sensors_0_alpha,sensors_0_used,sensors_0_cause"));
  EXPECT_THAT(lines[1], testing::EndsWith(",1,visual,0.25,0,1,\"blur, \"\"they\"\" say\""));
  EXPECT_THAT(lines[2], testing::EndsWith(",0,,,,,"));
}

TEST(MessageTable, PicturesAreTheirSizesAndTheirNotesText) {
  constexpr int kLarge = 100000;
  image_t picture{};
  picture.size = kLarge;
  picture.data.assign(kLarge, 7);
  image_metadata_t seq{};
  seq.key = "seq";
  seq.value = {'4', '2'};
  seq.n = 2;
  image_metadata_t odd{};
  odd.key = "odd";
  odd.value = {0x00, 0xff};
  odd.n = 2;
  picture.metadata = {seq, odd};
  picture.nmetadata = 2;
  const std::vector<std::string> lines = table_of<image_t>({picture});
  EXPECT_EQ(lines[0],
            "utime,width,height,row_stride,pixelformat,size,nmetadata,metadata_0_key,metadata_0_n,"
            "metadata_0_value,metadata_1_key,metadata_1_n,metadata_1_value");
  EXPECT_EQ(lines[1], "0,0,0,0,0,100000,2,seq,2,42,odd,2,0x00ff");
}

TEST(MessageTable, LongArraysAreLeftOutInEveryRow) {
  map_surfels_t large{};
  large.num_surfels = 513;
  const std::size_t count = 513;
  large.id.assign(count, 1);
  for (auto* values : {&large.x, &large.y, &large.z, &large.nx, &large.ny, &large.nz, &large.radius,
                       &large.confidence}) {
    values->assign(count, 1.5F);
  }
  for (auto* values : {&large.red, &large.green, &large.blue}) values->assign(count, 1);
  large.num_removed = 1;
  large.removed = {77};
  const std::vector<std::string> lines = table_of<map_surfels_t>({large, map_surfels_t{}});
  EXPECT_EQ(lines[0], "utime,map_version,reset,num_surfels,num_removed,removed_0");
  EXPECT_EQ(lines[1], "0,0,0,513,1,77");
  EXPECT_EQ(lines[2], "0,0,0,0,0,");
}

}  // namespace
}  // namespace gastronaut

#include "drivers/iio/codec.h"

#include <gtest/gtest.h>

#include <string>

namespace abcal::iio {
namespace {

using namespace std::string_literals;
using wire::FrameCheck;
using wire::FrameVerdict;

TEST(IioCodecTest, ReadsFormatsOfSamples) {
  EXPECT_EQ(parse_format("be:s20/32>>12"), (SampleFormat{true, true, 20, 4, 12}));
  EXPECT_EQ(parse_format("le:S64/64>>0"), (SampleFormat{false, true, 64, 8, 0}));
  EXPECT_EQ(parse_format("le:u12/16>>4"), (SampleFormat{false, false, 12, 2, 4}));
  for (const char* wrong :
       {"", "le:", "xx:s16/16>>0", "le:f16/16>>0", "le:s16/16X2>>0", "le:s16/24>>0", "le:s17/16>>0",
        "le:s16/16>>1", "le:s0/16>>0", "le:s16>>0/16", "le:s16/16>>", "le:s16/16>>0 "})
    EXPECT_FALSE(parse_format(wrong)) << wrong;
}

TEST(IioCodecTest, ReadsRepliesInPiecesOfAnySize) {
  struct Case {
    ReplyKind kind;
    std::string bytes;
    std::int64_t number;
    std::string text;
  };
  for (const Case& one :
       {Case{ReplyKind::kNumber, "0\n", 0, ""}, Case{ReplyKind::kNumber, "-22\n", -22, ""},
        Case{ReplyKind::kText, "9\n0.598550\0\n"s, 9, "0.598550"}, Case{ReplyKind::kText, "-2\n", -2, ""},
        Case{ReplyKind::kText, "0\n\n", 0, ""}, Case{ReplyKind::kName, "0\n", 0, ""},
        Case{ReplyKind::kName, "14\nadis16485-dev0\n", 14, "adis16485-dev0"}}) {
    SCOPED_TRACE(one.bytes);
    for (std::size_t n = 0; n < one.bytes.size(); ++n)
      EXPECT_EQ(check_reply(one.kind, one.bytes.substr(0, n)).check, FrameCheck::kNeedMore) << n;
    EXPECT_EQ(check_reply(one.kind, one.bytes + "123\n"),
              (FrameVerdict{FrameCheck::kComplete, one.bytes.size()}));
    EXPECT_EQ(number_of(one.bytes), one.number);
    if (one.kind != ReplyKind::kNumber) {
      EXPECT_EQ(text_of(one.bytes), one.text);
    }
  }
  for (const char* wrong : {"x\n", "\n", "-\n", "1 \n", "123456789012\n", "3\nabcd\n", "99999999\n"})
    EXPECT_EQ(check_reply(ReplyKind::kText, wrong).check, FrameCheck::kInvalid) << wrong;
}

TEST(IioCodecTest, FindsTheVersionBehindOtherBytes) {
  EXPECT_EQ(find_version("0.24.v0.24  \n")->text, "0.24.v0.24  ");
  const auto version = find_version("-22\n\x01\x02\n0.26.a1b2c3d\nmore");
  ASSERT_TRUE(version);
  EXPECT_EQ(version->text, "0.26.a1b2c3d");
  EXPECT_EQ(version->end, 20U);
  EXPECT_EQ(find_version("0.1.v0.1\n")->text, "0.1.v0.1") << "libtinyiiod";
  for (const char* wrong : {"0.24.v0.24  ", "0.24.\n", "0.24\n", "ESP301 Version 3.04 07/27/01\r\n",
                            "0,24.v0.24  \n", ".24.1234567\n",
                            "0.24.1234\x7f"
                            "67\n"})
    EXPECT_FALSE(find_version(wrong)) << wrong;
}

TEST(IioCodecTest, ReadsSamplesInChunks) {
  const std::string whole = "8\n00000047\nABCDEFGH";
  for (std::size_t n = 0; n < whole.size(); ++n)
    EXPECT_EQ(check_samples(whole.substr(0, n), 8, "00000047").check, FrameCheck::kNeedMore) << n;
  EXPECT_EQ(check_samples(whole + "0", 8, "00000047"), (FrameVerdict{FrameCheck::kComplete, whole.size()}));
  EXPECT_EQ(samples_of(whole, "00000047").bytes, "ABCDEFGH");

  // The mask comes once; an error ends it.
  const std::string chunks = "4\n00000047\nABCD4\nEFGH";
  EXPECT_EQ(check_samples(chunks, 8, "00000047").length, chunks.size());
  EXPECT_EQ(samples_of(chunks, "00000047").bytes, "ABCDEFGH");
  const std::string broken = "4\n00000047\nABCD-110\n";
  EXPECT_EQ(check_samples(broken, 8, "00000047").length, broken.size());
  EXPECT_EQ(samples_of(broken, "00000047").bytes, "ABCD");
  EXPECT_EQ(samples_of(broken, "00000047").error, -110);
  EXPECT_EQ(check_samples("-9\n", 8, "00000047").length, 3U);

  EXPECT_EQ(check_samples("9\n", 8, "00000047").check, FrameCheck::kInvalid);  // more than was asked
  EXPECT_EQ(check_samples("8\n00000007\n", 8, "00000047").check, FrameCheck::kInvalid);  // other channels
}

constexpr const char* kXml =
    "<?xml version=\"1.0\" encoding=\"utf-8\"?><!DOCTYPE context [<!ELEMENT context (device)*>]><context "
    "name=\"local\"><context-attribute name=\"local,kernel\" value=\"6.1.0\" /><device id=\"iio:device0\" "
    "name=\"adxl355\" ><channel id=\"accel_x\" type=\"input\" ><scan-element index=\"0\" "
    "format=\"be:s20/32&gt;&gt;12\" /><attribute name=\"calibbias\" filename=\"in_accel_x_calibbias\" "
    "/></channel><channel id=\"temp\" type=\"input\" ><scan-element index=\"3\" "
    "format=\"be:s12/16&gt;&gt;0\" /></channel><channel id=\"accel_z\" type=\"input\" ><scan-element "
    "index=\"2\" format=\"be:s20/32&gt;&gt;12\" /></channel><channel id=\"accel_y\" type=\"input\" "
    "><scan-element index=\"1\" format=\"be:s20/32&gt;&gt;12\" /></channel><channel id=\"timestamp\" "
    "type=\"input\" ><scan-element index=\"4\" format=\"le:S64/64&gt;&gt;0\" /></channel><attribute "
    "name=\"sampling_frequency\" /><debug-attribute name=\"serial_number\" /></device></context>";

TEST(IioCodecTest, ReadsTheDescriptionAndLaysOutItsScans) {
  const auto context = parse_context(kXml);
  ASSERT_TRUE(context);
  EXPECT_EQ(context->attributes.at("local,kernel"), "6.1.0");
  ASSERT_EQ(context->devices.size(), 1U);
  const Device& device = context->devices[0];
  EXPECT_EQ(device.name, "adxl355");
  EXPECT_TRUE(device.has("sampling_frequency"));
  EXPECT_TRUE(device.has_debug("serial_number"));
  ASSERT_NE(device.find("accel_x"), nullptr);
  EXPECT_TRUE(device.find("accel_x")->has("calibbias"));

  // By their indices, whatever the order of the list, whose places are the bits of the mask.
  const auto layout = lay_out(device);
  ASSERT_TRUE(layout);
  EXPECT_EQ(layout->mask, "0000001d");
  EXPECT_EQ(layout->axes[1].offset, 4U);
  EXPECT_EQ(layout->axes[2].offset, 8U);
  ASSERT_TRUE(layout->timestamp);
  EXPECT_EQ(layout->timestamp->offset, 16U);  // at a multiple of its own size
  EXPECT_EQ(layout->size, 24U);

  std::string scan("\x00\x01\x20\x00\xff\xff\xf0\x00\x80\x00\x00\x00"s);
  EXPECT_EQ(value_at(scan, layout->axes[0]).value, 18);
  EXPECT_EQ(value_at(scan, layout->axes[1]).value, -1);
  EXPECT_EQ(value_at(scan, layout->axes[2]).value, -524288);
  EXPECT_TRUE(value_at(scan, layout->axes[2]).at_end);
  EXPECT_FALSE(value_at(scan, layout->axes[1]).at_end);
  EXPECT_EQ(value_at("\x34\xf2"s, Place{{false, false, 12, 2, 4}, 0}).value, 0xf23);
}

TEST(IioCodecTest, WhatIsNoDescriptionIsRefused) {
  const std::string xml = kXml;
  EXPECT_FALSE(parse_context(""));
  EXPECT_FALSE(parse_context("<device/>"));
  EXPECT_FALSE(parse_context(xml.substr(0, xml.size() - 5)));
  EXPECT_FALSE(parse_context("<!DOCTYPE c [<!ENTITY a \"b\">]><context/>"));
  auto context = *parse_context(xml);
  context.devices[0].channels[2].id = "accel_q";
  EXPECT_FALSE(lay_out(context.devices[0]));
}

}  // namespace
}  // namespace abcal::iio

#include "app/console/request.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace abcal::console {
namespace {

template <class T>
T read(const std::string& text) {
  return std::get<T>(parse_request(text).command);
}

std::string refusal(const std::string& text) {
  try {
    parse_request(text);
    return "accepted";
  } catch (const RequestError& error) {
    return error.what();
  }
}

TEST(RequestTest, ReadsEveryRequestThatDocsNames) {
  EXPECT_EQ(parse_request(R"({"do":"hold","id":7})").id, 7);
  EXPECT_FALSE(read<TakeControl>(R"({"do":"control"})").from_another);
  EXPECT_TRUE(read<TakeControl>(R"({"do":"control","from_another":true})").from_another);
  read<ReleaseControl>(R"({"do":"control","release":true})");
  EXPECT_FALSE(read<CheckBench>(R"({"do":"check"})").with_motion);
  EXPECT_TRUE(read<CheckBench>(R"({"do":"check","with_motion":true,"confirmed":true})").with_motion);
  read<StartRun>(R"({"do":"start","confirmed":true})");
  read<HoldRun>(R"({"do":"hold"})");
  read<ContinueRun>(R"({"do":"continue","confirmed":true})");
  read<Stop>(R"({"do":"stop"})");
  EXPECT_EQ(read<ResumeRun>(R"({"do":"resume","run":"a.run","confirmed":true})").run, "a.run");
  EXPECT_FALSE(read<ResumeRun>(R"({"do":"resume","run":"a.run","confirmed":true})").without_missing_items);
  EXPECT_TRUE(
      read<ResumeRun>(R"({"do":"resume","run":"a.run","confirmed":true,"without_missing_items":true})")
          .without_missing_items);
  const Jog jog = read<Jog>(R"({"do":"jog","axis":"z","by_deg":-12.5,"confirmed":true})");
  EXPECT_EQ(jog.axis, StageAxis::kZ);
  EXPECT_EQ(jog.how, Jog::How::kBy);
  EXPECT_EQ(jog.angle.deg(), -12.5);
  EXPECT_EQ(read<Jog>(R"({"do":"jog","axis":"x","to_deg":90,"confirmed":true})").how, Jog::How::kTo);
  const Jog held = read<Jog>(R"({"do":"jog","axis":"x","while_held":"down","confirmed":true})");
  EXPECT_EQ(held.how, Jog::How::kWhileHeld);
  EXPECT_LT(held.angle.deg(), 0.0);
  EXPECT_FALSE(read<KeepTurning>(R"({"do":"keep_turning"})").let_go);
  EXPECT_TRUE(read<KeepTurning>(R"({"do":"keep_turning","let_go":true})").let_go);
  read<AskControl>(R"({"do":"control","ask":true})");
  EXPECT_EQ(read<AnswerControl>(R"({"do":"control","hand_over_to":3})").page, 3);
  EXPECT_TRUE(read<AnswerControl>(R"({"do":"control","hand_over_to":3})").hand_over);
  EXPECT_FALSE(read<AnswerControl>(R"({"do":"control","not_to":3})").hand_over);
  EXPECT_EQ(read<Acknowledge>(R"({"do":"acknowledge","run":"a.run"})").run, "a.run");
  EXPECT_EQ(read<Note>(R"({"do":"note","text":"door opened, 23 °C"})").text, "door opened, 23 °C");
}

TEST(RequestTest, WhatMovesHardwareNeedsAYes) {
  for (const char* text :
       {R"({"do":"start"})", R"({"do":"start","confirmed":false})", R"({"do":"continue"})",
        R"({"do":"resume","run":"a.run"})", R"({"do":"jog","axis":"x","by_deg":1})",
        R"({"do":"jog","axis":"x","while_held":"up"})", R"({"do":"check","with_motion":true})"})
    EXPECT_THAT(refusal(text), testing::HasSubstr("confirmed")) << text;
}

TEST(RequestTest, RefusesWhatIsNotUnderstood) {
  for (const char* text : {"",
                           "{",
                           "null",
                           "[]",
                           "3",
                           R"("stop")",
                           "{}",
                           R"({"do":3})",
                           R"({"do":"explode"})",
                           R"({"do":"stop","now":true})",
                           R"({"do":"start","confirmed":1})",
                           R"({"do":"start","confirmed":"true"})",
                           R"({"do":"start","confirmed":true,"estimator":"x"})",
                           R"({"do":"stop","id":-1})",
                           R"({"do":"stop","id":1.5})",
                           R"({"do":"stop","id":1e300})",
                           R"({"do":"resume","run":7,"confirmed":true})",
                           R"({"do":"resume","run":"a.run","confirmed":true,"without_missing_items":1})",
                           R"({"do":"jog","axis":"y","by_deg":1,"confirmed":true})",
                           R"({"do":"jog","axis":"x","by_deg":361,"confirmed":true})",
                           R"({"do":"jog","axis":"x","by_deg":1e999,"confirmed":true})",
                           R"({"do":"jog","axis":"x","by_deg":null,"confirmed":true})",
                           R"({"do":"jog","axis":"x","by_deg":"10","confirmed":true})",
                           R"({"do":"jog","axis":"x","by_deg":1,"to_deg":1,"confirmed":true})",
                           R"({"do":"jog","axis":"x","while_held":"up","by_deg":1,"confirmed":true})",
                           R"({"do":"jog","axis":"x","while_held":"sideways","confirmed":true})",
                           R"({"do":"control","hand_over_to":"3"})",
                           R"({"do":"control","not_to":0})",
                           R"({"do":"note","text":""})",
                           R"({"do":"note","text":"two\nlines"})",
                           "{\"do\":\"note\",\"text\":\"\xff\xfe\"}"})
    EXPECT_NE(refusal(text), "accepted") << text;
  EXPECT_NE(refusal(R"({"do":"note","text":")" + std::string(kLongestNote + 1, 'a') + R"("})"), "accepted");
  EXPECT_EQ(refusal(R"({"do":"note","text":")" + std::string(kLongestNote, 'a') + R"("})"), "accepted");
  EXPECT_THAT(refusal(std::string(kLongestRequest + 1, ' ')), testing::HasSubstr("4096"));
  EXPECT_NE(refusal(std::string(kLongestRequest, '[')), "accepted");  // Depth is bounded by length.
}

TEST(RequestTest, RefusesAKeyThatIsGivenTwice) {
  EXPECT_EQ(refusal(R"({"do":"jog","axis":"x","by_deg":1,"by_deg":90,"confirmed":true})"),
            "\"by_deg\" is given twice");
  EXPECT_EQ(refusal(R"({"do":"stop","do":"stop"})"), "\"do\" is given twice");
  EXPECT_EQ(refusal(R"({"do":"stop","\u0064o":"hold"})"), "\"do\" is given twice") << "however it is written";
  EXPECT_EQ(refusal(R"({"do":"start","confirmed":true,"item":{"serial_number":"1","serial_number":"2"}})"),
            "\"serial_number\" is given twice");
  EXPECT_EQ(refusal(R"({"do":"start","confirmed":true,"item":{"serial_number":"do","model":"do"}})"),
            "accepted")
      << "values may be alike";
}

TEST(RequestTest, SaysWhatIsMissing) {
  EXPECT_THAT(refusal(R"({"do":"jog","axis":"x","confirmed":true})"),
              testing::HasSubstr("\"by_deg\" is missing"));
  EXPECT_THAT(refusal(R"({"do":"start","confirmed":true,"speed":2})"),
              testing::HasSubstr("\"speed\" does not belong"));
}

}  // namespace
}  // namespace abcal::console

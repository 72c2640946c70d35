// SPDX-License-Identifier: Apache-2.0
#include "fitter/profiles/profile_csv.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

class ProfileCsv : public ScratchFolderTest {
 protected:
  std::string Write(const std::string& text) {
    const auto file = folder_ / "profiles.csv";
    std::ofstream(file) << text;
    return file.string();
  }
  // The message of a file that must be refused, without its folder.
  std::string Refused(const std::string& text, bool with_radiance = true) {
    const auto file = ReadProfiles(Write(text), with_radiance);
    EXPECT_FALSE(file.ok());
    if (file.ok()) return "";
    EXPECT_EQ(file.status().code(), StatusCode::kUsage);
    const std::string& message = file.status().message();
    return message.substr(message.find("profiles.csv"));
  }
};

const char* const kHeader = "source,incidence_deg,exit_deg,slit_mm,u_mm,radiance\n";

TEST_F(ProfileCsv, ReadsColumnsByNameInAnyOrderAndRowsOfSourcesMixed) {
  const auto file = ReadProfiles(Write("# measured on Tuesday\n"
                                       "radiance,u_mm,note,slit_mm,exit_deg,incidence_deg,source\r\n"
                                       "0.3,0.5,x,0.25,0,-45,a\r\n"
                                       "0.1,0,y,1,30,+0,\"b, left\"\r\n"
                                       "\r\n"
                                       "0.2,1.0,z,0.25,0,-45,a\r\n"
                                       "0.4,0.0,z,0.25,0,-45,a\r\n"
                                       "0.1,2e-1,y,1,30,0,\"b, left\"\r\n"
                                       "0.1,.4,y,1,30,0,\"b, left\"\r\n"),
                                 true);
  ASSERT_TRUE(file.ok()) << file.status().message();
  ASSERT_EQ(file->profiles.size(), 2U);
  const LineProfile &a = file->profiles[0], &b = file->profiles[1];
  EXPECT_EQ(a.source, "a");
  EXPECT_EQ(a.incidence_deg, -45.0);
  EXPECT_EQ(a.slit_mm, 0.25);
  EXPECT_EQ(a.first_u_mm, 0.0);
  EXPECT_NEAR(a.step_mm, 0.5, 1e-12);
  EXPECT_EQ(a.radiance, (std::vector<double>{0.4, 0.3, 0.2}));  // by rising u
  EXPECT_EQ(b.source, "b, left");
  EXPECT_EQ(b.exit_deg, 30.0);
  EXPECT_EQ(file->placement[0], (std::pair{0, 1}));
  EXPECT_EQ(file->placement[2], (std::pair{0, 2}));
}

TEST_F(ProfileCsv, NamesFileLineValueAndRemedy) {
  EXPECT_THAT(Refused(""), HasSubstr("profiles.csv: empty"));
  EXPECT_THAT(Refused(kHeader), HasSubstr("no data after the header"));
  EXPECT_THAT(Refused("source,incidence_deg,exit_deg,slit_mm,radiance\na,0,0,1,0.1\n"),
              HasSubstr("profiles.csv:1: column 'u_mm' is missing"));
  EXPECT_THAT(Refused("source,incidence_deg,exit_deg,slit_mm,u_mm\na,0,0,1,0\n"), HasSubstr("'radiance' is missing"));
  const std::string rows = std::string(kHeader) + "a,0,0,1,0,0.1\na,0,0,1,0.1,0.2\n";
  EXPECT_THAT(Refused(rows), HasSubstr("profiles.csv:2: source 'a' has 2 samples"));
  EXPECT_THAT(Refused(rows + "a,0,0,1,0.25,0.1\n"), HasSubstr("breaks the regular step"));
  EXPECT_THAT(Refused(rows + "a,0,0,1,0.1,0.1\n"), HasSubstr("profiles.csv:4: source 'a': u_mm = 0.1 appears twice"));
  EXPECT_THAT(Refused(rows + "a,0,0,1,0.2,nan\n"), HasSubstr("profiles.csv:4: radiance = 'nan'"));
  EXPECT_THAT(Refused(rows + "a,0,0,1,0.2,0.1x\n"), HasSubstr("profiles.csv:4: radiance = '0.1x'"));
  EXPECT_THAT(Refused(rows + "a,0,0,1,0.2\n"), HasSubstr("profiles.csv:4: 5 fields"));
  EXPECT_THAT(Refused(rows + "a,10,0,1,0.2,0.1\n"), HasSubstr("profiles.csv:4: source 'a' changes its incidence"));
  EXPECT_THAT(Refused(rows + "b,90,0,1,0.2,0.1\n"), HasSubstr("incidence_deg = 90"));
  EXPECT_THAT(Refused(rows + "b,0,0,0,0.2,0.1\n"), HasSubstr("slit_mm = 0"));
  EXPECT_THAT(Refused(rows + ",0,0,1,0.2,0.1\n"), HasSubstr("source is empty"));
  EXPECT_THAT(Refused(rows + "Stirn hell gr\xfcn,0,0,1,0.2,0.1\n"),
              HasSubstr("profiles.csv:4: source 'Stirn hell gr\\xfcn' is not UTF-8; save the table as UTF-8"));
  EXPECT_THAT(Refused(rows + "\"a,0,0,1,0.2,0.1\n"), HasSubstr("quote is not closed"));
}

TEST_F(ProfileCsv, AMissingFileIsNotFound) {
  const auto file = ReadProfiles("/nowhere/profiles.csv", true);
  ASSERT_FALSE(file.ok());
  EXPECT_EQ(file.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(file.status().message(), HasSubstr("/nowhere/profiles.csv"));
}

TEST_F(ProfileCsv, RoundingOfUToTwoDigitsIsStillRegular) {
  std::string text = kHeader;
  for (int k = 0; k < 50; ++k) {
    std::ostringstream u;
    u.precision(2);
    u << std::fixed << k / 3.0;
    text += "a,0,0,1," + u.str() + ",0.1\n";
  }
  EXPECT_TRUE(ReadProfiles(Write(text), true).ok());
}

TEST_F(ProfileCsv, AppendsRadianceAndKeepsTheRest) {
  const auto file = ReadProfiles(Write("source,incidence_deg,exit_deg,slit_mm,u_mm,note\n"
                                       "\"b, \"\"x\"\"\",0,0,1,0.2,p\nc,0,0,1,0,q\n\"b, \"\"x\"\"\",0,0,1,0.0,r\n"
                                       "\"b, \"\"x\"\"\",0,0,1,0.1,s\nc,0,0,1,1,t\nc,0,0,1,2,u\n"),
                                 false);
  ASSERT_TRUE(file.ok()) << file.status().message();
  const auto out = (folder_ / "out.csv").string();
  ASSERT_TRUE(WriteProfiles(out, file->table, {1, 2, 3, 4, 5, 0.1}).ok());
  std::ifstream in(out);
  std::string header, first;
  std::getline(in, header);
  std::getline(in, first);
  EXPECT_EQ(header, "source,incidence_deg,exit_deg,slit_mm,u_mm,note,radiance");
  EXPECT_EQ(first, "\"b, \"\"x\"\"\",0,0,1,0.2,p,1");
  const auto again = ReadProfiles(out, true);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(again->profiles[0].source, "b, \"x\"");
  EXPECT_EQ(again->profiles[0].radiance, (std::vector<double>{3, 4, 1}));
}

}  // namespace
}  // namespace stratalux::fit

// The wire vectors of a profile as tests of GoogleTest: DCP_VECTORS=folder/dcp-2.0 ./wire_test
//
// With a decoder of your own, replace dcp_check_beacon, show_values and encode_values.
#include "show_values.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace {

using Fields = std::vector<std::string>;

std::vector<Fields> load()
{
    const char *const folder = std::getenv("DCP_VECTORS");
    std::ifstream file(std::string(folder != nullptr ? folder : ".") + "/wire.txt");
    std::vector<Fields> found;
    for (std::string line; std::getline(file, line);) {
        Fields fields;
        std::istringstream parts(line);
        for (std::string part; std::getline(parts, part, '\t');)
            fields.push_back(part);
        if (line[0] != '#')
            found.push_back(fields);
    }
    return found;
}

std::vector<uint8_t> octets_of(const std::string &hex)
{
    std::vector<uint8_t> octets;
    for (size_t i = 0; hex != "-" && i < hex.size(); i += 2)
        octets.push_back(static_cast<uint8_t>(std::stoul(hex.substr(i, 2), nullptr, 16)));
    return octets;
}

class Wire : public testing::TestWithParam<Fields> {};

TEST_P(Wire, IsDecoded)
{
    const Fields &fields = GetParam();
    const std::vector<uint8_t> octets = octets_of(fields[2]);
    SCOPED_TRACE(fields[1]);
    dcp_problem_t problem;
    const bool good = dcp_check_beacon(octets.data(), octets.size(), &problem);
    ASSERT_EQ(good, fields[0] == "V") << dcp_reason_name(problem.reason);
    if (!good) {
        const std::string requirement = dcp_requirement_name(problem.requirement), field = problem.field;
        EXPECT_EQ(dcp_reason_name(problem.reason), fields[3]);
        EXPECT_EQ(std::to_string(problem.offset), fields[4]);
        EXPECT_EQ(requirement.empty() ? "-" : requirement, fields[5]);
        EXPECT_EQ(field.empty() ? "-" : field, fields[6]);
        EXPECT_EQ(std::to_string(problem.needed), fields[7]);
        EXPECT_EQ(std::to_string(problem.available), fields[8]);
        return;
    }
    EXPECT_EQ(std::to_string(problem.offset), fields[3]);
    static text_t text;
    text.size = 0;
    show_values(&text, octets.data(), octets.size());
    EXPECT_EQ(text.data, fields[5]);
    if (fields[4] == "both") {
        std::vector<uint8_t> again(octets.size());
        dcp_writer_t writer;
        dcp_write_to(&writer, again.data(), again.size());
        EXPECT_TRUE(encode_values(&writer, octets.data(), octets.size()));
        EXPECT_EQ(again, octets);
    }
}

INSTANTIATE_TEST_SUITE_P(Vectors, Wire, testing::ValuesIn(load()));

} // namespace

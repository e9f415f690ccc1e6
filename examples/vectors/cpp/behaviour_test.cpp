// The behaviour vectors of a profile as tests of GoogleTest: DCP_VECTORS=folder/dcp-2.0 ./behaviour_test
//
// It is linked with vector.c, and with sut.c of the same folder or one of your own.
#include "vector.h"

#include <gtest/gtest.h>

#include <cctype>
#include <cstdlib>
#include <fstream>
#include <ostream>
#include <string>
#include <vector>

void vector_failed(const char *what, const char *expected, const char *found)
{
    ADD_FAILURE() << what << "\n  expected " << expected << "\n  found    " << found;
}

namespace {

struct Vector {
    std::string name;
    std::vector<std::string> lines;
};

void PrintTo(const Vector &vector, std::ostream *stream)
{
    *stream << vector.name;
}

std::vector<Vector> load()
{
    const char *const folder = std::getenv("DCP_VECTORS");
    std::ifstream file(std::string(folder != nullptr ? folder : ".") + "/behaviour.txt");
    std::vector<Vector> found;
    std::string node;
    for (std::string line; std::getline(file, line);) {
        if (line[0] == 'N')
            node = line;
        if (line[0] == 'T')
            found.push_back({line.substr(2, line.find('\t', 2) - 2), {node}});
        if (!found.empty())
            found.back().lines.push_back(line);
    }
    return found;
}

std::string name_of(const testing::TestParamInfo<Vector> &info)
{
    std::string name = info.param.name.substr(info.param.name.rfind('/') + 1);
    for (char &each : name)
        if (std::isalnum(static_cast<unsigned char>(each)) == 0)
            each = '_';
    return name;
}

class Behaviour : public testing::TestWithParam<Vector> {};

TEST_P(Behaviour, IsPermitted)
{
    for (std::string line : GetParam().lines)
        vector_line(&line[0]);
    vector_end();
}

INSTANTIATE_TEST_SUITE_P(Vectors, Behaviour, testing::ValuesIn(load()), name_of);

} // namespace

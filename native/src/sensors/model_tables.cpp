// Written by tools/sensor_tables.py from lidarcodec/sensors/models: sources of all numbers are there.
#include "sensors/block_model.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kChannels0[] = {15, 13, 11, 9, 7, 5, 3, 1, 14, 12, 10, 8, 6, 4, 2, 0};
constexpr SeriesPlan kSeries1[] = {{"azimuth", 2, 12}, {"time_us", 4, 1}, {"mode", 1, 1}};
constexpr SeriesPlan kSeries2[] = {{"azimuth", 2, 6}, {"azimuth_rest", 2, 6}, {"time_us", 4, 1}};
constexpr PacketLayout kLayouts3[] = {{"single", 24, 12, false, kSeries1, {}}, {"dual", 12, 6, true, kSeries2, {}}};
constexpr std::uint8_t kChannels4[] = {31, 29, 27, 25, 23, 21, 19, 17, 15, 13, 11, 9, 7, 5, 3, 1,
                                       30, 28, 26, 24, 22, 20, 18, 16, 14, 12, 10, 8, 6, 4, 2, 0};
constexpr PacketLayout kLayouts5[] = {{"single", 12, 12, false, kSeries1, {}}, {"dual", 6, 6, true, kSeries2, {}}};
constexpr std::uint8_t kChannels6[] = {29, 30, 25, 26, 21, 22, 17, 13, 18, 14, 9,  5, 10, 6, 1, 31,
                                       2,  28, 27, 23, 24, 20, 19, 15, 16, 12, 11, 8, 7,  4, 3, 0};
constexpr std::uint8_t kChannels7[] = {
    59,  74,  41,  120, 31,  110, 13, 92, 51,  66, 33,  112, 23, 102, 5,  84,  107, 10, 89,  56,  79, 46,
    125, 28,  99,  2,   81,  48,  71, 38, 117, 20, 43,  122, 25, 104, 15, 94,  61,  76, 35,  114, 17, 96,
    7,   86,  53,  68,  91,  58,  73, 40, 127, 30, 109, 12,  83, 50,  65, 32,  119, 22, 101, 4,   27, 106,
    9,   88,  63,  78,  45,  124, 19, 98, 1,   80, 55,  70,  37, 116, 75, 42,  121, 24, 111, 14,  93, 60,
    67,  34,  113, 16,  103, 6,   85, 52, 11,  90, 57,  72,  47, 126, 29, 108, 3,   82, 49,  64,  39, 118,
    21,  100, 123, 26,  105, 8,   95, 62, 77,  44, 115, 18,  97, 0,   87, 54,  69,  36};
constexpr SeriesPlan kSeries8[] = {{"azimuth", 2, 3}, {"azimuth_rest", 2, 9}, {"time_us", 4, 1}, {"mode", 1, 1}};
constexpr SeriesPlan kSeries9[] = {{"azimuth", 2, 1}, {"azimuth_rest", 2, 7}, {"padding", 1, 400}, {"time_us", 4, 1}};
constexpr PacketLayout kLayouts10[] = {{"single", 3, 3, false, kSeries8, {}}, {"dual", 1, 1, true, kSeries9, {}}};
constexpr std::uint8_t kChannels11[] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13, 14, 15, 16, 17, 18, 19,
                                        20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35, 36, 37, 38, 39};
constexpr SeriesPlan kSeries12[] = {{"azimuth", 2, 10},  {"reserved", 1, 5},    {"shutdown", 1, 1},
                                    {"reserved2", 1, 2}, {"motor_speed", 2, 1}, {"time_us", 4, 1},
                                    {"mode", 1, 1},      {"factory", 1, 1},     {"date", 1, 6}};
constexpr std::int32_t kTimes13[] = {-528620, -473060, -417500, -361940, -306380,
                                     -250820, -195260, -139700, -84140,  -28580};
constexpr SeriesPlan kSeries14[] = {{"azimuth", 2, 5},   {"azimuth_rest", 2, 5}, {"reserved", 1, 5}, {"shutdown", 1, 1},
                                    {"reserved2", 1, 2}, {"motor_speed", 2, 1},  {"time_us", 4, 1},  {"mode", 1, 1},
                                    {"factory", 1, 1},   {"date", 1, 6}};
constexpr std::int32_t kTimes15[] = {-250820, -195260, -139700, -84140, -28580};
constexpr SeriesPlan kSeries16[] = {
    {"azimuth", 2, 10}, {"reserved", 1, 5}, {"shutdown", 1, 1}, {"reserved2", 1, 2}, {"motor_speed", 2, 1},
    {"time_us", 4, 1},  {"mode", 1, 1},     {"factory", 1, 1},  {"date", 1, 6},      {"udp_sequence", 4, 1}};
constexpr SeriesPlan kSeries17[] = {{"azimuth", 2, 5},  {"azimuth_rest", 2, 5}, {"reserved", 1, 5},
                                    {"shutdown", 1, 1}, {"reserved2", 1, 2},    {"motor_speed", 2, 1},
                                    {"time_us", 4, 1},  {"mode", 1, 1},         {"factory", 1, 1},
                                    {"date", 1, 6},     {"udp_sequence", 4, 1}};
constexpr PacketLayout kLayouts18[] = {{"single", 10, 10, false, kSeries12, kTimes13},
                                       {"dual", 5, 5, true, kSeries14, kTimes15},
                                       {"single_2", 10, 10, false, kSeries16, kTimes13},
                                       {"dual_2", 5, 5, true, kSeries17, kTimes15}};
constexpr std::int32_t kTimes19[] = {-42220, -28470, -16040, -3620,  -45490, -31740, -47460, -54670, -20620, -33710,
                                     -40910, -8190,  -20620, -27160, -50730, -8190,  -14740, -36980, -45490, -52700,
                                     -23890, -31740, -38950, -11470, -18650, -25190, -48760, -6230,  -12770, -35010,
                                     -21920, -9500,  -43520, -29770, -17350, -4920,  -42220, -28470, -16040, -3620};
constexpr std::uint8_t kChannels20[] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13, 14, 15,
                                        16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31,
                                        32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47,
                                        48, 49, 50, 51, 52, 53, 54, 55, 56, 57, 58, 59, 60, 61, 62, 63};
constexpr SeriesPlan kSeries21[] = {{"azimuth", 2, 6},     {"head_reserved", 1, 1}, {"head_reserved2", 1, 2},
                                    {"reserved", 1, 5},    {"shutdown", 1, 1},      {"reserved2", 1, 2},
                                    {"motor_speed", 2, 1}, {"time_us", 4, 1},       {"mode", 1, 1},
                                    {"factory", 1, 1},     {"date", 1, 6},          {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes22[] = {-320380, -264820, -209260, -153700, -98140, -42580};
constexpr SeriesPlan kSeries23[] = {
    {"azimuth", 2, 3},  {"azimuth_rest", 2, 3}, {"head_reserved", 1, 1}, {"head_reserved2", 1, 2}, {"reserved", 1, 5},
    {"shutdown", 1, 1}, {"reserved2", 1, 2},    {"motor_speed", 2, 1},   {"time_us", 4, 1},        {"mode", 1, 1},
    {"factory", 1, 1},  {"date", 1, 6},         {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes24[] = {-153700, -98140, -42580};
constexpr SeriesPlan kSeries25[] = {{"azimuth", 2, 6},     {"head_reserved", 1, 1}, {"head_reserved2", 1, 2},
                                    {"reserved", 1, 5},    {"shutdown", 1, 1},      {"reserved2", 1, 2},
                                    {"motor_speed", 2, 1}, {"time_us", 4, 1},       {"mode", 1, 1},
                                    {"factory", 1, 1},     {"date", 1, 6}};
constexpr SeriesPlan kSeries26[] = {{"azimuth", 2, 3},        {"azimuth_rest", 2, 3}, {"head_reserved", 1, 1},
                                    {"head_reserved2", 1, 2}, {"reserved", 1, 5},     {"shutdown", 1, 1},
                                    {"reserved2", 1, 2},      {"motor_speed", 2, 1},  {"time_us", 4, 1},
                                    {"mode", 1, 1},           {"factory", 1, 1},      {"date", 1, 6}};
constexpr PacketLayout kLayouts27[] = {{"single", 6, 6, false, kSeries21, kTimes22},
                                       {"dual", 3, 3, true, kSeries23, kTimes24},
                                       {"single_2", 6, 6, false, kSeries25, kTimes22},
                                       {"dual_2", 3, 3, true, kSeries26, kTimes24}};
constexpr std::int32_t kTimes28[] = {
    -23180, -21876, -20572, -19268, -17964, -16660, -11444, -46796, -7532,  -36956, -50732, -54668, -40892,
    -44828, -31052, -34988, -48764, -52700, -38924, -42860, -29084, -33020, -46796, -25148, -36956, -50732,
    -27116, -40892, -44828, -31052, -34988, -48764, -25148, -38924, -42860, -29084, -33020, -52700, -6228,
    -54668, -15356, -27116, -10140, -23180, -4924,  -21876, -14052, -17964, -8836,  -19268, -3620,  -20572,
    -12748, -16660, -7532,  -11444, -6228,  -15356, -10140, -4924,  -3620,  -14052, -8836,  -12748};
constexpr std::uint8_t kChannels29[] = {63, 62, 61, 60, 59, 58, 57, 56, 55, 54, 53, 52, 51, 50, 49, 48,
                                        47, 46, 45, 44, 43, 42, 41, 40, 39, 38, 37, 36, 35, 34, 33, 32,
                                        31, 30, 29, 28, 27, 26, 25, 24, 23, 22, 21, 20, 19, 18, 17, 16,
                                        15, 14, 13, 12, 11, 10, 9,  8,  7,  6,  5,  4,  3,  2,  1,  0};
constexpr SeriesPlan kSeries30[] = {{"azimuth", 2, 4},     {"protocol", 1, 4}, {"first_block", 1, 1},
                                    {"returns", 1, 1},     {"flags", 1, 1},    {"reserved", 1, 10},
                                    {"motor_speed", 2, 1}, {"time_us", 4, 1},  {"mode", 1, 1},
                                    {"factory", 1, 1},     {"date", 1, 6},     {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes31[] = {25710, 192376, 359043, 525710};
constexpr SeriesPlan kSeries32[] = {
    {"azimuth", 2, 2}, {"azimuth_rest", 2, 2}, {"protocol", 1, 4},    {"first_block", 1, 1}, {"returns", 1, 1},
    {"flags", 1, 1},   {"reserved", 1, 10},    {"motor_speed", 2, 1}, {"time_us", 4, 1},     {"mode", 1, 1},
    {"factory", 1, 1}, {"date", 1, 6},         {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes33[] = {25710, 192376};
constexpr SeriesPlan kSeries34[] = {{"azimuth", 2, 4}, {"protocol", 1, 4},  {"first_block", 1, 1}, {"returns", 1, 1},
                                    {"flags", 1, 1},   {"reserved", 1, 10}, {"motor_speed", 2, 1}, {"time_us", 4, 1},
                                    {"mode", 1, 1},    {"factory", 1, 1},   {"date", 1, 6}};
constexpr SeriesPlan kSeries35[] = {{"azimuth", 2, 2},     {"azimuth_rest", 2, 2}, {"protocol", 1, 4},
                                    {"first_block", 1, 1}, {"returns", 1, 1},      {"flags", 1, 1},
                                    {"reserved", 1, 10},   {"motor_speed", 2, 1},  {"time_us", 4, 1},
                                    {"mode", 1, 1},        {"factory", 1, 1},      {"date", 1, 6}};
constexpr PacketLayout kLayouts36[] = {{"single", 4, 4, false, kSeries30, kTimes31},
                                       {"dual", 2, 2, true, kSeries32, kTimes33},
                                       {"single_2", 4, 4, false, kSeries34, kTimes31},
                                       {"dual_2", 2, 2, true, kSeries35, kTimes33}};
constexpr std::int32_t kTimes37[] = {
    12310,  14370,  16430,  18490,  20540,  22600,  24660,  26710,  29160,  31220,  33280,  35340,  37390,
    39450,  41500,  43560,  46610,  48670,  50730,  52780,  54840,  56900,  58950,  61010,  63450,  65520,
    67580,  69630,  71690,  73740,  75800,  77860,  80900,  82970,  85020,  87080,  89140,  91190,  93250,
    95300,  97750,  99820,  101870, 103930, 105980, 108040, 110100, 112150, 115200, 117260, 119320, 121380,
    123430, 125490, 127540, 129600, 132050, 134110, 136170, 138220, 140280, 142340, 144390, 146450};
constexpr std::uint8_t kChannels38[] = {
    127, 126, 125, 124, 123, 122, 121, 120, 119, 118, 117, 116, 115, 114, 95, 113, 94, 112, 93, 111, 92, 110,
    91,  109, 90,  108, 89,  107, 88,  106, 87,  105, 86,  104, 85,  103, 84, 102, 83, 101, 82, 100, 81, 99,
    80,  98,  79,  97,  78,  96,  77,  76,  75,  74,  73,  72,  71,  70,  69, 68,  67, 66,  65, 64,  63, 62,
    61,  60,  59,  58,  57,  56,  55,  54,  53,  52,  51,  50,  49,  48,  47, 46,  45, 44,  43, 42,  41, 40,
    39,  38,  37,  36,  35,  34,  33,  32,  31,  30,  29,  28,  27,  26,  25, 24,  23, 22,  21, 20,  19, 18,
    17,  16,  15,  14,  13,  12,  11,  10,  9,   8,   7,   6,   5,   4,   3,  2,   1,  0};
constexpr SeriesPlan kSeries39[] = {
    {"azimuth", 2, 2},   {"protocol", 1, 4},     {"first_block", 1, 1}, {"returns", 1, 1},  {"flags", 1, 1},
    {"crc_body", 4, 1},  {"safety", 1, 13},      {"crc_safety", 4, 1},  {"reserved", 1, 5}, {"mode_flag", 1, 1},
    {"reserved2", 1, 6}, {"mode", 1, 1},         {"motor_speed", 2, 1}, {"date", 1, 6},     {"time_us", 4, 1},
    {"factory", 1, 1},   {"udp_sequence", 4, 1}, {"crc_tail", 4, 1},    {"security", 1, 32}};
constexpr std::int32_t kTimes40[] = {9000, 120110};
constexpr SeriesPlan kSeries41[] = {
    {"azimuth", 2, 1},   {"azimuth_rest", 2, 1}, {"protocol", 1, 4},     {"first_block", 1, 1}, {"returns", 1, 1},
    {"flags", 1, 1},     {"crc_body", 4, 1},     {"safety", 1, 13},      {"crc_safety", 4, 1},  {"reserved", 1, 5},
    {"mode_flag", 1, 1}, {"reserved2", 1, 6},    {"mode", 1, 1},         {"motor_speed", 2, 1}, {"date", 1, 6},
    {"time_us", 4, 1},   {"factory", 1, 1},      {"udp_sequence", 4, 1}, {"crc_tail", 4, 1},    {"security", 1, 32}};
constexpr std::int32_t kTimes42[] = {9000};
constexpr SeriesPlan kSeries43[] = {
    {"azimuth", 2, 2},   {"protocol", 1, 4},     {"first_block", 1, 1}, {"returns", 1, 1},  {"flags", 1, 1},
    {"crc_body", 4, 1},  {"safety", 1, 13},      {"crc_safety", 4, 1},  {"reserved", 1, 5}, {"mode_flag", 1, 1},
    {"reserved2", 1, 6}, {"mode", 1, 1},         {"motor_speed", 2, 1}, {"date", 1, 6},     {"time_us", 4, 1},
    {"factory", 1, 1},   {"udp_sequence", 4, 1}, {"crc_tail", 4, 1}};
constexpr SeriesPlan kSeries44[] = {
    {"azimuth", 2, 1},   {"azimuth_rest", 2, 1}, {"protocol", 1, 4},     {"first_block", 1, 1}, {"returns", 1, 1},
    {"flags", 1, 1},     {"crc_body", 4, 1},     {"safety", 1, 13},      {"crc_safety", 4, 1},  {"reserved", 1, 5},
    {"mode_flag", 1, 1}, {"reserved2", 1, 6},    {"mode", 1, 1},         {"motor_speed", 2, 1}, {"date", 1, 6},
    {"time_us", 4, 1},   {"factory", 1, 1},      {"udp_sequence", 4, 1}, {"crc_tail", 4, 1}};
constexpr PacketLayout kLayouts45[] = {{"single", 2, 2, false, kSeries39, kTimes40},
                                       {"dual", 1, 1, true, kSeries41, kTimes42},
                                       {"single_2", 2, 2, false, kSeries43, kTimes40},
                                       {"dual_2", 1, 1, true, kSeries44, kTimes42}};
constexpr std::int32_t kTimes46[] = {
    0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,      0,     0,     0,
    0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,      0,     0,     0,
    27656, 53000, 2312,  78344, 81512, 5480,  56168, 30824, 33992, 59336, 8648,  84680, 87848,  11816, 62504, 37160,
    40328, 65672, 14984, 91016, 94184, 18152, 68840, 43496, 46664, 72008, 21320, 97352, 100520, 24488, 75176, 49832,
    1456,  77488, 26800, 52144, 55312, 29968, 80656, 4624,  7792,  83824, 33136, 58480, 61648,  36304, 86992, 10960,
    14128, 90160, 39472, 64816, 67984, 42640, 93328, 17296, 20464, 96496, 45808, 71152, 74320,  48976, 99664, 23632,
    25944, 51288, 600,   76632, 79800, 3768,  54456, 29112, 32280, 57624, 6936,  82968, 86136,  10104, 60792, 35448,
    38616, 63960, 13272, 89304, 92472, 16440, 67128, 41784, 44952, 70296, 19608, 95640, 98808,  22776, 73464, 48120};
constexpr std::int32_t kTimes47[] = {
    2312,  78344, 27656, 53000, 56168, 30824, 81512, 5480,  8648,  84680, 33992, 59336, 62504, 37160, 87848,  11816,
    14984, 91016, 40328, 65672, 68840, 43496, 94184, 18152, 21320, 97352, 46664, 72008, 75176, 49832, 100520, 24488,
    0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,      0,
    0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,     0,      0,
    600,   76632, 25944, 51288, 54456, 29112, 79800, 3768,  6936,  82968, 32280, 57624, 60792, 35448, 86136,  10104,
    13272, 89304, 38616, 63960, 67128, 41784, 92472, 16440, 19608, 95640, 44952, 70296, 73464, 48120, 98808,  22776,
    26800, 52144, 1456,  77488, 80656, 4624,  55312, 29968, 33136, 58480, 7792,  83824, 86992, 10960, 61648,  36304,
    39472, 64816, 14128, 90160, 93328, 17296, 67984, 42640, 45808, 71152, 20464, 96496, 99664, 23632, 74320,  48976};
constexpr std::uint8_t kChannels48[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
constexpr SeriesPlan kSeries49[] = {{"azimuth", 2, 8}, {"protocol", 1, 4},    {"first_block", 1, 1},
                                    {"returns", 1, 1}, {"flags", 1, 1},       {"reserved", 1, 10},
                                    {"mode", 1, 1},    {"motor_speed", 2, 1}, {"date", 1, 6},
                                    {"time_us", 4, 1}, {"factory", 1, 1},     {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes50[] = {-344368, -294368, -244368, -194368, -144368, -94368, -44368, 5632};
constexpr SeriesPlan kSeries51[] = {
    {"azimuth", 2, 4}, {"azimuth_rest", 2, 4}, {"protocol", 1, 4},    {"first_block", 1, 1}, {"returns", 1, 1},
    {"flags", 1, 1},   {"reserved", 1, 10},    {"mode", 1, 1},        {"motor_speed", 2, 1}, {"date", 1, 6},
    {"time_us", 4, 1}, {"factory", 1, 1},      {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes52[] = {-144368, -94368, -44368, 5632};
constexpr PacketLayout kLayouts53[] = {{"single", 8, 8, false, kSeries49, kTimes50},
                                       {"dual", 4, 4, true, kSeries51, kTimes52}};
constexpr std::int32_t kTimes54[] = {368,   3392,  6416,  9440,  12464, 15488, 18512, 21536,
                                     24560, 27584, 30608, 33632, 36656, 39680, 42704, 45728};
constexpr std::uint8_t kChannels55[] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13, 14, 15,
                                        16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31};
constexpr std::int32_t kTimes56[] = {368,   1880,  3392,  4904,  6416,  7928,  9440,  10952, 12464, 13976, 15488,
                                     17000, 18512, 20024, 21536, 23048, 24560, 26072, 27584, 29096, 30608, 32120,
                                     33632, 35144, 36656, 38168, 39680, 41192, 42704, 44216, 45728, 47240};
constexpr SeriesPlan kSeries57[] = {{"azimuth", 2, 6}, {"protocol", 1, 4},    {"first_block", 1, 1},
                                    {"returns", 1, 1}, {"flags", 1, 1},       {"reserved", 1, 10},
                                    {"mode", 1, 1},    {"motor_speed", 2, 1}, {"date", 1, 6},
                                    {"time_us", 4, 1}, {"factory", 1, 1},     {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes58[] = {-244368, -194368, -144368, -94368, -44368, 5632};
constexpr SeriesPlan kSeries59[] = {
    {"azimuth", 2, 3}, {"azimuth_rest", 2, 3}, {"protocol", 1, 4},    {"first_block", 1, 1}, {"returns", 1, 1},
    {"flags", 1, 1},   {"reserved", 1, 10},    {"mode", 1, 1},        {"motor_speed", 2, 1}, {"date", 1, 6},
    {"time_us", 4, 1}, {"factory", 1, 1},      {"udp_sequence", 4, 1}};
constexpr std::int32_t kTimes60[] = {-94368, -44368, 5632};
constexpr PacketLayout kLayouts61[] = {{"single", 6, 6, false, kSeries57, kTimes58},
                                       {"dual", 3, 3, true, kSeries59, kTimes60}};
constexpr std::int32_t kTimes62[] = {368,   3256,  6144,  9032,  11920, 14808, 17696, 20584, 23472, 26360, 29248,
                                     32136, 35024, 37912, 40800, 43688, 368,   3256,  6144,  9032,  11920, 14808,
                                     17696, 20584, 23472, 26360, 29248, 32136, 35024, 37912, 40800, 43688};
constexpr BlockModel kModels63[] = {
    {"vlp16", BlockKind::Velodyne, 20000, kChannels0, kLayouts3, 55.296, 2.304, 1, {}, {}},
    {"puck_hires", BlockKind::Velodyne, 20000, kChannels0, kLayouts3, 55.296, 2.304, 1, {}, {}},
    {"hdl32e", BlockKind::Velodyne, 20000, kChannels4, kLayouts5, 46.08, 1.152, 1, {}, {}},
    {"vlp32c", BlockKind::Velodyne, 40000, kChannels6, kLayouts5, 55.296, 2.304, 2, {}, {}},
    {"vls128", BlockKind::Vls128, 40000, kChannels7, kLayouts10, 57.800000000000004, 2.89, 8, {}, {}},
    {"pandar40p", BlockKind::Hesai, 40000, kChannels11, kLayouts18, 0, 0, 1, kTimes19, {}},
    {"pandar64", BlockKind::Hesai, 40000, kChannels20, kLayouts27, 0, 0, 1, kTimes28, {}},
    {"qt64", BlockKind::Hesai, 40000, kChannels29, kLayouts36, 0, 0, 1, kTimes37, {}},
    {"qt128", BlockKind::Qt128, 40000, kChannels38, kLayouts45, 0, 0, 1, kTimes46, kTimes47},
    {"xt16", BlockKind::Hesai, 40000, kChannels48, kLayouts53, 0, 0, 1, kTimes54, {}},
    {"xt32", BlockKind::Hesai, 40000, kChannels55, kLayouts53, 0, 0, 1, kTimes56, {}},
    {"xt32m", BlockKind::Hesai, 50000, kChannels55, kLayouts61, 0, 0, 1, kTimes62, {}}};

}  // namespace

std::span<const BlockModel> block_models() { return kModels63; }

}  // namespace lidarcodec

/* Decoder of lidarcodec streams for C and C++: bytes of messages in, images and points of frames out, of every sensor.
 *
 * A session decodes one stream, message after message, as a recording or a subscription has them. Codecs: raw, zstd,
 * pcodec, predictive, riddle, png; jxl, jpeg, jpeg-layered, h264 and h264-log, if the program opens their pictures.
 * Others are refused by name. Nothing here throws, prints or ends the process. A session is used by one thread at a
 * time; several sessions may be used by several threads at once. */
#ifndef LIDARCODEC_H
#define LIDARCODEC_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#define LIDARCODEC_API
#else
#define LIDARCODEC_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* What became of a call. After each of them the next message can be pushed. */
typedef enum lidarcodec_status {
  LIDARCODEC_OK = 0,
  LIDARCODEC_BAD_HEADER = 1,        /* no message, or one whose header contradicts itself */
  LIDARCODEC_UNSUPPORTED = 2,       /* a newer format, or a codec that is not decoded here */
  LIDARCODEC_TRUNCATED = 3,         /* fewer bytes than announced */
  LIDARCODEC_BAD_CHECKSUM = 4,      /* the checksum does not match */
  LIDARCODEC_BAD_SECTION = 5,       /* a section that cannot be what it says */
  LIDARCODEC_MISSING_REFERENCE = 6, /* a frame, calibration or weights that were not received: ask for a key frame */
  LIDARCODEC_OUT_OF_MEMORY = 7,
  LIDARCODEC_FAILED = 8 /* anything else: a fault of this library */
} lidarcodec_status;

typedef struct lidarcodec_session lidarcodec_session;

typedef enum lidarcodec_role {
  LIDARCODEC_RANGE = 0,        /* of first returns */
  LIDARCODEC_SECOND_RANGE = 1, /* of second returns */
  LIDARCODEC_ATTRIBUTE = 2
} lidarcodec_role;

/* An image, rows x width numbers, row after row. `range` and `range2` are in steps of the sensor, 0 = no return; others
 * are as the sensor sends them. docs/sensors.md says which sensor has which. */
typedef struct lidarcodec_plane {
  const char* name;   /* "range", "intensity", "range2", "signal", "near_ir", ... */
  const void* values; /* uint8_t, uint16_t or uint32_t: `bytes` of each number */
  uint8_t bytes;      /* 1, 2 or 4 */
  uint8_t bits;       /* that its numbers can have */
  uint8_t role;       /* lidarcodec_role */
  uint8_t of;         /* of an attribute: place in `planes` of the range plane that it describes */
} lidarcodec_plane;

/* A frame of `rows` rows, row 0 the highest beam, and `width` columns. Images are stored row after row. All pointers
 * hold until the next call with the session. */
typedef struct lidarcodec_frame {
  uint64_t stream_id;
  uint64_t index;        /* counts frames of a stream from 0 */
  int64_t stamp_ns;      /* host time of the first packet, ns since 1970-01-01 UTC */
  uint16_t codec;        /* number of the codec, docs/wire-format.md */
  uint8_t key;           /* 1: decoded without any message before it */
  uint8_t has_intensity; /* 0: the stream sends none */
  uint32_t rows;         /* 1 to 128 */
  uint32_t width;
  uint32_t points;                /* first returns in the frame */
  uint32_t plane_count;           /* 0 of a point cloud, and if no packet of the frame has an image */
  double range_step_m;            /* metres of one step of `range` */
  const lidarcodec_plane* planes; /* the first is `range` */
  const uint16_t* azimuth; /* 2 x width, 0.01 degree, 0 to 35999: of the upper and lower half of each column of an
                              HDL-64E; of other sensors both are that of the column */
  const uint8_t* fired;    /* 2 x width: 1 where the half of a column was sent */
  const uint8_t* laser;    /* rows: hardware id of the laser of each row */
  const double* pose;      /* 3 x 4, the first rows of T_world_sensor, row after row; NULL where it is not known */
  const char* sensor;      /* name of the sensor, UTF-8 */
  const char* model;       /* "hdl64e", "vlp16", "os1-128", ...: docs/sensors.md */
} lidarcodec_frame;

/* A return. Metres; x forward, y left, z up, of the sensor. The value of any plane for it is at the place `cell`; of a
 * second return in the plane with a 2 at the end of its name, if there is one. */
typedef struct lidarcodec_point {
  float x, y, z;
  uint32_t intensity;
  uint32_t cell;         /* ring * width + column; of a point cloud the place among the points of its message */
  uint8_t laser, ring;   /* hardware id; row, 0 at the top */
  uint8_t return_number; /* 1, or 2 of a second return */
  uint8_t reserved;
  int64_t t_ns; /* host time of the firing, ns since 1970-01-01 UTC; of an HDL-64E that of the frame */
} lidarcodec_point;

/* Types of the fields of a point cloud, numbered as in sensor_msgs/PointField. */
typedef enum lidarcodec_type {
  LIDARCODEC_INT8 = 1,
  LIDARCODEC_UINT8 = 2,
  LIDARCODEC_INT16 = 3,
  LIDARCODEC_UINT16 = 4,
  LIDARCODEC_INT32 = 5,
  LIDARCODEC_UINT32 = 6,
  LIDARCODEC_FLOAT32 = 7,
  LIDARCODEC_FLOAT64 = 8
} lidarcodec_type;

/* A field of a point cloud (model "pointcloud2"), as its driver's message has it. x, y and z are fields, too. */
typedef struct lidarcodec_field {
  const char* name; /* as sent; holds until the next call */
  uint32_t count;   /* values of each point */
  uint8_t type;     /* lidarcodec_type */
  uint8_t bytes;    /* of a value: 1, 2, 4 or 8 */
} lidarcodec_field;

typedef enum lidarcodec_returns {
  LIDARCODEC_FIRST = 1,
  LIDARCODEC_ALL = 2 /* second returns too, of other sensors than an HDL-64E */
} lidarcodec_returns;

/* A new session; NULL without memory, which no other function but `lidarcodec_close` takes. Bytes and points may be
 * NULL where their size is 0. */
LIDARCODEC_API lidarcodec_session* lidarcodec_open(void);
LIDARCODEC_API void lidarcodec_close(lidarcodec_session* session);

/* Gives the session a weight file (.lcrw) of codec riddle that streams may name without sending it, such as those
 * installed in share/lidarcodec/weights. Its name is the hash of its bytes. */
LIDARCODEC_API lidarcodec_status lidarcodec_give_weights(lidarcodec_session* session, const uint8_t* data, size_t size);

/* A grey picture: `rows` x `width` samples of `bits` bits. By the number of its codec `data` is
 *   5 jxl                       a bare JPEG XL codestream of 16 bits, without loss, not yet looked at;
 *   6 jpeg, 7 jpeg-layered      a JPEG of 8 or 12 bits, sequential, of one component. Its header says these sides and
 *                               bits;
 *   8 h264, 9 h264-log          an access unit of H.264 in the byte stream format, 8 or 10 bits. If `begins` is 1, it
 * is an IDR picture, whose sequence parameters say these sides and bits: what came before is to be forgotten. Else it
 * is a P picture, and refers to the one that was given last. */
typedef struct lidarcodec_picture {
  const uint8_t* data;
  size_t size;
  uint32_t rows;
  uint32_t width;
  uint16_t codec; /* number of the codec */
  uint8_t bits;
  uint8_t begins; /* 0: a P picture of H.264 */
} lidarcodec_picture;

/* Writes the samples of a picture, row after row. Returns 1; 0 if it is damaged, or anything but a picture of these
 * sides and bits. It must not throw: what follows the header may be hostile, and so is all of a picture of jxl. */
typedef int (*lidarcodec_open_picture)(void* context, const lidarcodec_picture* picture, uint16_t* samples);

/* Has the session open the pictures of a codec by a function, to which `context` is handed: for videos one of its own
 * for each session. NULL: by none, but those of png by the session's own. Codecs are 4 to 9: of others there are no
 * pictures. */
LIDARCODEC_API lidarcodec_status lidarcodec_give_pictures(lidarcodec_session* session, uint16_t codec,
                                                          lidarcodec_open_picture open, void* context);

/* Decodes one whole message. `frame` is set where the status is LIDARCODEC_OK, else left as it was; NULL where only
 * points are wanted. A message of jpeg-layered has further frames: see `lidarcodec_next`. */
LIDARCODEC_API lidarcodec_status lidarcodec_push(lidarcodec_session* session, const uint8_t* message, size_t size,
                                                 lidarcodec_frame* frame);

/* Goes on to the next frame of the message that was pushed last: all functions are about it from now on. Returns 1;
 * 0 if there is none: then nothing has changed. `frame` may be NULL. */
LIDARCODEC_API int lidarcodec_next(lidarcodec_session* session, lidarcodec_frame* frame);

/* Points of the frame that was pushed last, column by column, second returns after all first ones. Those of a point
 * cloud come in the order of its message, without those that have no return. Up to `capacity` of them are written.
 * Returns how many there are: 0 without memory, and 0 if the directions of the beams are not known, as of an Ouster
 * without its metadata. */
LIDARCODEC_API size_t lidarcodec_points(const lidarcodec_session* session, lidarcodec_returns returns,
                                        lidarcodec_point* points, size_t capacity);

/* Fields of the point cloud that was pushed last, in the order of its message. Up to `capacity` of them are written.
 * Returns how many there are: 0 for other sensors, and for a message that is no PointCloud2. */
LIDARCODEC_API size_t lidarcodec_fields(const lidarcodec_session* session, lidarcodec_field* fields, size_t capacity);

/* Values of a field, by its place in `lidarcodec_fields`. There are `count` for each point of the message, also for
 * points without a return; those of a lidarcodec_point begin at `cell * count`. Up to `capacity` values are written,
 * `bytes` each, in the machine's byte order. Returns how many there are, 0 if there is no such field. */
LIDARCODEC_API size_t lidarcodec_values(const lidarcodec_session* session, size_t field, void* values, size_t capacity);

/* The message of the point cloud that was pushed last, byte for byte; if the stream has a bound on the error, x, y and
 * z differ by up to that. It begins with four bytes that docs/wire-format-clouds.md explains, and holds until the next
 * call. NULL, and a size of 0, for other sensors. */
LIDARCODEC_API const uint8_t* lidarcodec_message(const lidarcodec_session* session, size_t* size);

/* Of the last call that failed: a sentence in English, the byte at which it was seen, and with
 * LIDARCODEC_MISSING_REFERENCE the index of the frame that is needed. The sentence holds until the next call. */
LIDARCODEC_API const char* lidarcodec_error_text(const lidarcodec_session* session);
LIDARCODEC_API uint64_t lidarcodec_error_offset(const lidarcodec_session* session);
LIDARCODEC_API uint64_t lidarcodec_error_needs(const lidarcodec_session* session);

#ifdef __cplusplus
}
#endif

#endif

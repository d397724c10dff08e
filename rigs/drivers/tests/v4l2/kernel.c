/*
 * A V4L2 capture device without a kernel module: preloaded (LD_PRELOAD), it answers what a program asks of the nodes named in
 * WCAL_V4L2, by the kernel's own header and the rules of videobuf2 (Linux media user-space API, "Video for Linux API"):
 * a queued buffer cannot be queued again (EINVAL), the format is fixed while buffers are there (EBUSY), frames without a free
 * buffer are lost but counted, an inactive control cannot be set (EACCES). Frame k of a node holds (x + 2 y + k) mod 256.
 *
 * WCAL_V4L2="/dev/video70 key=value ...;/dev/video71 ..."; keys:
 *   fourcc=GREY|YUYV|MJPG width= height= pad= rate= phase_us= card= stall_at= stall_ms= error_at= unplug_at= meta= stamp=
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define MOST 8
#define BUFFERS 8

struct node {
	char path[64], card[32], fourcc[5];
	long width, height, pad, rate, phase_us, stall_at, stall_ms, error_at, unplug_at, meta, stamp;
	int fd, count, state[BUFFERS], streaming, gone;
	long order[BUFFERS], queued;
	long next;       /* number of the next frame */
	long long start; /* us */
	int automatic, exposure, priority, gain;
	pthread_mutex_t lock;
};

enum { IDLE, QUEUED, DONE };

static struct node nodes[MOST];
static struct v4l2_buffer done[MOST][BUFFERS];
static int known;
static long (*real_syscall)(long, ...);
static int (*real_open)(const char *, int, ...);
static int (*real_poll)(struct pollfd *, nfds_t, int);
static int (*real_close)(int);

static long long now_us(void)
{
	struct timespec t;
	clock_gettime(CLOCK_MONOTONIC, &t);
	return t.tv_sec * 1000000LL + t.tv_nsec / 1000;
}

static void set(struct node *n, const char *key, const char *value)
{
	struct { const char *name; long *at; } numbers[] = {
		{ "width", &n->width }, { "height", &n->height }, { "pad", &n->pad }, { "rate", &n->rate },
		{ "phase_us", &n->phase_us }, { "stall_at", &n->stall_at }, { "stall_ms", &n->stall_ms },
		{ "error_at", &n->error_at }, { "unplug_at", &n->unplug_at }, { "meta", &n->meta }, { "stamp", &n->stamp },
	};
	for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
		if (!strcmp(numbers[i].name, key)) { *numbers[i].at = atol(value); return; }
	if (!strcmp(key, "card")) snprintf(n->card, sizeof n->card, "%s", value);
	else if (!strcmp(key, "fourcc")) snprintf(n->fourcc, sizeof n->fourcc, "%s", value);
	else { fprintf(stderr, "kernel.c: unknown key %s\n", key); abort(); }
}

__attribute__((constructor)) static void begin(void)
{
	real_syscall = dlsym(RTLD_NEXT, "syscall");
	real_open = dlsym(RTLD_NEXT, "open");
	real_poll = dlsym(RTLD_NEXT, "poll");
	real_close = dlsym(RTLD_NEXT, "close");
	const char *given = getenv("WCAL_V4L2");
	char *text = strdup(given ? given : ""), *outer, *inner;
	for (char *one = strtok_r(text, ";", &outer); one && known < MOST; one = strtok_r(NULL, ";", &outer)) {
		struct node *n = &nodes[known++];
		*n = (struct node){ .card = "Virtual camera", .fourcc = "GREY", .width = 64, .height = 48, .rate = 50, .stall_at = -1,
			.error_at = -1, .unplug_at = -1, .stamp = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC, .fd = -1, .automatic = 3,
			.exposure = 157, .priority = 1, .gain = 4 };
		pthread_mutex_init(&n->lock, NULL);
		for (char *word = strtok_r(one, " ", &inner); word; word = strtok_r(NULL, " ", &inner)) {
			char *equals = strchr(word, '=');
			if (!equals) { snprintf(n->path, sizeof n->path, "%s", word); continue; }
			*equals = 0;
			set(n, word, equals + 1);
		}
	}
	free(text);
}

static struct node *of(int fd)
{
	for (int i = 0; i < known; i++)
		if (fd >= 0 && nodes[i].fd == fd) return &nodes[i];
	return NULL;
}

static long pixel(const struct node *n) { return strcmp(n->fourcc, "YUYV") ? 1 : 2; }
static long stride(const struct node *n) { return n->width * pixel(n) + n->pad; }
static long size_of(const struct node *n) { return stride(n) * n->height; }
static long room(const struct node *n) { return (size_of(n) + 4095) / 4096 * 4096; }

static long long due_us(const struct node *n, long frame)
{
	return n->start + frame * 1000000LL / n->rate + n->phase_us;
}

/* Fills the oldest queued buffer with each frame that is due. */
static void advance(struct node *n)
{
	struct v4l2_buffer *filled = done[n - nodes];
	while (n->streaming && !n->gone && due_us(n, n->next) <= now_us()) {
		long frame = n->next++;
		if (n->unplug_at >= 0 && frame >= n->unplug_at) { n->gone = 1; break; }
		int oldest = -1;
		for (int i = 0; i < n->count; i++)
			if (n->state[i] == QUEUED && (oldest < 0 || n->order[i] < n->order[oldest])) oldest = i;
		if (oldest < 0) continue; /* lost, but counted */
		unsigned char *line = malloc(stride(n));
		for (long y = 0; y < n->height; y++) {
			memset(line, 200, stride(n));
			for (long x = 0; x < n->width; x++) line[x * pixel(n)] = (unsigned char)(x + 2 * y + frame);
			if (pwrite(n->fd, line, stride(n), oldest * room(n) + y * stride(n)) < 0) abort();
		}
		free(line);
		long long at = due_us(n, frame);
		filled[oldest] = (struct v4l2_buffer){ .bytesused = size_of(n), .sequence = frame,
			.flags = n->stamp | (frame == n->error_at ? V4L2_BUF_FLAG_ERROR : 0),
			.timestamp = { .tv_sec = at / 1000000, .tv_usec = at % 1000000 } };
		n->state[oldest] = DONE;
	}
}

static int format(struct node *n, struct v4l2_format *f, int change)
{
	if (f->type != V4L2_BUF_TYPE_VIDEO_CAPTURE) return EINVAL;
	struct v4l2_pix_format *p = &f->fmt.pix;
	if (change && n->count) return EBUSY;
	/* As a driver does: the nearest that it has. */
	*p = (struct v4l2_pix_format){ .width = n->width, .height = n->height, .bytesperline = stride(n), .sizeimage = size_of(n),
		.pixelformat = v4l2_fourcc(n->fourcc[0], n->fourcc[1], n->fourcc[2], n->fourcc[3]), .field = V4L2_FIELD_NONE };
	return 0;
}

static const struct control { unsigned id; const char *name; int type; long low, high, usual; } controls[] = {
	{ V4L2_CID_GAIN, "Gain", V4L2_CTRL_TYPE_INTEGER, 0, 30, 4 },
	{ V4L2_CID_EXPOSURE_AUTO, "Auto Exposure", V4L2_CTRL_TYPE_MENU, 0, 3, 3 },
	{ V4L2_CID_EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", V4L2_CTRL_TYPE_INTEGER, 3, 2047, 157 },
	{ V4L2_CID_EXPOSURE_AUTO_PRIORITY, "Exposure, Dynamic Framerate", V4L2_CTRL_TYPE_BOOLEAN, 0, 1, 1 },
};
#define CONTROLS (sizeof controls / sizeof *controls)

static int *value_of(struct node *n, unsigned id)
{
	return id == V4L2_CID_GAIN ? &n->gain : id == V4L2_CID_EXPOSURE_AUTO ? &n->automatic
		: id == V4L2_CID_EXPOSURE_ABSOLUTE ? &n->exposure : id == V4L2_CID_EXPOSURE_AUTO_PRIORITY ? &n->priority : NULL;
}

static int query(struct v4l2_query_ext_ctrl *q)
{
	unsigned flags = V4L2_CTRL_FLAG_NEXT_CTRL | V4L2_CTRL_FLAG_NEXT_COMPOUND, id = q->id & ~flags;
	int after = (q->id & flags) != 0;
	for (size_t i = 0; i < CONTROLS; i++) {
		const struct control *c = &controls[i];
		if (after ? c->id <= id : c->id != id) continue;
		*q = (struct v4l2_query_ext_ctrl){ .id = c->id, .type = c->type, .minimum = c->low, .maximum = c->high, .step = 1,
			.default_value = c->usual, .elem_size = 4, .elems = 1 };
		snprintf(q->name, sizeof q->name, "%s", c->name);
		return 0;
	}
	return EINVAL;
}

static int set_or_get(struct node *n, struct v4l2_ext_controls *all, int change)
{
	for (unsigned i = 0; i < all->count; i++) {
		struct v4l2_ext_control *one = &all->controls[i];
		int *value = value_of(n, one->id);
		all->error_idx = i;
		if (!value) return EINVAL;
		if (!change) { one->value = *value; continue; }
		for (size_t k = 0; k < CONTROLS; k++)
			if (controls[k].id == one->id && (one->value < controls[k].low || one->value > controls[k].high)) return ERANGE;
		if (one->id == V4L2_CID_EXPOSURE_ABSOLUTE && n->automatic != V4L2_EXPOSURE_MANUAL) return EACCES;
		/* A UVC camera has manual and aperture priority only. */
		if (one->id == V4L2_CID_EXPOSURE_AUTO && one->value != V4L2_EXPOSURE_MANUAL && one->value != 3) return EINVAL;
		*value = one->value;
	}
	return 0;
}

static int answer(struct node *n, unsigned long request, void *arg)
{
	advance(n);
	if (n->gone) return ENODEV;
	struct v4l2_buffer *b = arg;
	switch ((unsigned)request) {
	case VIDIOC_QUERYCAP: {
		struct v4l2_capability *c = arg;
		unsigned what = n->meta ? V4L2_CAP_META_CAPTURE : V4L2_CAP_VIDEO_CAPTURE;
		*c = (struct v4l2_capability){ .driver = "virtual", .bus_info = "usb-virtual-1", .version = 0x060100,
			.capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING | V4L2_CAP_DEVICE_CAPS,
			.device_caps = what | V4L2_CAP_STREAMING };
		memcpy(c->card, n->card, sizeof n->card);
		return 0;
	}
	case VIDIOC_ENUM_FMT: {
		struct v4l2_fmtdesc *d = arg;
		if (d->index || d->type != V4L2_BUF_TYPE_VIDEO_CAPTURE || n->meta) return EINVAL;
		d->pixelformat = v4l2_fourcc(n->fourcc[0], n->fourcc[1], n->fourcc[2], n->fourcc[3]);
		snprintf((char *)d->description, sizeof d->description, "%s", n->fourcc);
		return 0;
	}
	case VIDIOC_G_FMT: return format(n, arg, 0);
	case VIDIOC_S_FMT: return format(n, arg, 1);
	case VIDIOC_G_PARM:
	case VIDIOC_S_PARM: {
		struct v4l2_streamparm *p = arg;
		if (p->type != V4L2_BUF_TYPE_VIDEO_CAPTURE) return EINVAL;
		p->parm.capture.capability = V4L2_CAP_TIMEPERFRAME;
		p->parm.capture.timeperframe = (struct v4l2_fract){ 1, n->rate };
		return 0;
	}
	case VIDIOC_QUERY_EXT_CTRL: return query(arg);
	case VIDIOC_QUERYMENU: {
		struct v4l2_querymenu *m = arg;
		if (m->id != V4L2_CID_EXPOSURE_AUTO || (m->index != 1 && m->index != 3)) return EINVAL;
		snprintf((char *)m->name, sizeof m->name, "%s", m->index == 1 ? "Manual Mode" : "Aperture Priority Mode");
		return 0;
	}
	case VIDIOC_G_EXT_CTRLS: return set_or_get(n, arg, 0);
	case VIDIOC_S_EXT_CTRLS: return set_or_get(n, arg, 1);
	case VIDIOC_REQBUFS: {
		struct v4l2_requestbuffers *r = arg;
		if (r->memory != V4L2_MEMORY_MMAP || r->type != V4L2_BUF_TYPE_VIDEO_CAPTURE) return EINVAL;
		n->count = r->count = r->count > BUFFERS ? BUFFERS : r->count;
		n->streaming = 0;
		memset(n->state, 0, sizeof n->state);
		return ftruncate(n->fd, n->count * room(n)) ? errno : 0;
	}
	case VIDIOC_QUERYBUF:
		if (b->index >= (unsigned)n->count) return EINVAL;
		b->length = room(n);
		b->m.offset = b->index * room(n);
		return 0;
	case VIDIOC_QBUF:
		if (b->index >= (unsigned)n->count || b->memory != V4L2_MEMORY_MMAP || n->state[b->index] != IDLE) return EINVAL;
		n->state[b->index] = QUEUED;
		n->order[b->index] = n->queued++;
		return 0;
	case VIDIOC_DQBUF: {
		int oldest = -1;
		if (!n->streaming) return EINVAL;
		for (int i = 0; i < n->count; i++)
			if (n->state[i] == DONE && (oldest < 0 || n->order[i] < n->order[oldest])) oldest = i;
		if (oldest < 0) return EAGAIN; /* opened with O_NONBLOCK */
		unsigned type = b->type;
		*b = done[n - nodes][oldest];
		b->index = oldest;
		b->type = type;
		b->memory = V4L2_MEMORY_MMAP;
		n->state[oldest] = IDLE;
		/* The pause begins when its frame has been taken, however late the reader is. */
		if (n->stall_at >= 0 && b->sequence >= n->stall_at) {
			n->start += now_us() + n->stall_ms * 1000 - due_us(n, n->next);
			n->stall_at = -1;
		}
		return 0;
	}
	case VIDIOC_STREAMON:
		if (!n->count) return EINVAL;
		n->streaming = 1;
		n->next = 0;
		/* One trigger for all cameras: frames lie on a common grid, their numbers start with the node's own stream. */
		n->start = (now_us() * n->rate / 1000000 + 1) * 1000000 / n->rate;
		return 0;
	case VIDIOC_STREAMOFF:
		n->streaming = 0;
		memset(n->state, 0, sizeof n->state);
		return 0;
	}
	return ENOTTY;
}

static int control_node(struct node *n, unsigned long request, void *arg)
{
	pthread_mutex_lock(&n->lock);
	int error = answer(n, request, arg);
	pthread_mutex_unlock(&n->lock);
	if (error) errno = error;
	return error ? -1 : 0;
}

int ioctl(int fd, unsigned long request, ...)
{
	va_list list;
	va_start(list, request);
	void *arg = va_arg(list, void *);
	va_end(list);
	struct node *n = of(fd);
	return n ? control_node(n, request, arg) : (int)real_syscall(SYS_ioctl, fd, request, arg);
}

long syscall(long number, ...)
{
	long a[6];
	va_list list;
	va_start(list, number);
	for (int i = 0; i < 6; i++) a[i] = va_arg(list, long);
	va_end(list);
	struct node *n = number == SYS_ioctl ? of((int)a[0]) : NULL;
	if (n) return control_node(n, a[1], (void *)a[2]);
	if (!real_syscall) real_syscall = dlsym(RTLD_NEXT, "syscall");
	return real_syscall(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

static int open_node(const char *path, int flags, mode_t mode)
{
	for (int i = 0; i < known; i++)
		if (!strcmp(nodes[i].path, path)) {
			if (nodes[i].gone) { errno = ENODEV; return -1; }
			return nodes[i].fd = memfd_create(path, 0);
		}
	if (!real_open) real_open = dlsym(RTLD_NEXT, "open");
	return real_open(path, flags, mode);
}

int open(const char *path, int flags, ...)
{
	va_list list;
	va_start(list, flags);
	mode_t mode = va_arg(list, int);
	va_end(list);
	return open_node(path, flags, mode);
}

int open64(const char *path, int flags, ...)
{
	va_list list;
	va_start(list, flags);
	mode_t mode = va_arg(list, int);
	va_end(list);
	return open_node(path, flags | O_LARGEFILE, mode);
}

int close(int fd)
{
	struct node *n = of(fd);
	if (n) { n->fd = -1; n->count = n->streaming = 0; }
	if (!real_close) real_close = dlsym(RTLD_NEXT, "close");
	return real_close(fd);
}

int poll(struct pollfd *fds, nfds_t count, int timeout_ms)
{
	struct pollfd asked;
	memcpy(&asked, fds, count ? sizeof asked : 0);
	struct node *n = count == 1 ? of(asked.fd) : NULL;
	if (!real_poll) real_poll = dlsym(RTLD_NEXT, "poll");
	if (!n) return real_poll(fds, count, timeout_ms);
	for (long long end = now_us() + timeout_ms * 1000LL;; usleep(200)) {
		pthread_mutex_lock(&n->lock);
		advance(n);
		int ready = 0, waiting = 0;
		for (int i = 0; i < n->count; i++) { ready |= n->state[i] == DONE; waiting |= n->state[i] == QUEUED; }
		/* As vb2_poll: an error when not streaming, or nothing was queued; a pulled plug wakes too. */
		int bad = n->gone || !n->streaming || (!ready && !waiting);
		pthread_mutex_unlock(&n->lock);
		fds->revents = bad ? POLLERR : ready ? POLLIN : 0;
		if (fds->revents) return 1;
		if (timeout_ms >= 0 && now_us() >= end) return 0;
	}
}

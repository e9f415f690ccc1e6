/* The node on a link of Linux: an interface (packet socket) or UDP, with a Unix socket for the upper tester. */
#define _GNU_SOURCE
#include "upper_tester.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/if_packet.h>
#include <net/ethernet.h>
#include <net/if.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#define ETHER_TYPE 0x4953
#define UDP_GROUP "239.73.126.1"
#define UDP_PORT 0x4953
#define MAX_SESSIONS 64
#define MAX_LINE (1u << 20)
#define MAX_WAITING (32u << 20) /* octets for a client that does not read; then it is disconnected */

/* A buffer that grows. */
typedef struct buffer {
    char *data;
    size_t size;
    size_t room;
} buffer_t;

/* One client of the control socket. */
typedef struct connection {
    int fd; /* -1: none */
    bool ended, skipping;
    session_t session;
    buffer_t in, out;
} connection_t;

static node_t node;
static connection_t connections[MAX_SESSIONS];
static int owner[UINT16_MAX + 1]; /* of a protocol: the session that registered it plus 1 */
static buffer_t notices[MAX_SESSIONS]; /* notifications that follow the answer to the request that caused them */
static int link_fd = -1, listener = -1;
static struct sockaddr_ll ethernet;
static struct sockaddr_in udp, own_address;
static int udp_sender = -1;
static volatile sig_atomic_t stopped;

static int64_t read_clock(clockid_t which)
{
    struct timespec t;
    (void)clock_gettime(which, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static node_time_t now(void)
{
    node_time_t t;
    t.now = read_clock(CLOCK_MONOTONIC);
    t.wall = read_clock(CLOCK_REALTIME);
    return t;
}

static void fatal(const char *what)
{
    perror(what);
    exit(1);
}

static void add(buffer_t *buffer, const char *data, size_t size)
{
    if (buffer->size + size > buffer->room) {
        buffer->room = 2 * (buffer->size + size);
        buffer->data = realloc(buffer->data, buffer->room);
        if (buffer->data == NULL)
            fatal("memory");
    }
    memcpy(buffer->data + buffer->size, data, size);
    buffer->size += size;
}

static void consume(buffer_t *buffer, size_t size)
{
    buffer->size -= size;
    memmove(buffer->data, buffer->data + size, buffer->size);
}

/* ---- events of the node -------------------------------------------------------------------------------------------- */

static void send_beacon(void *user, const uint8_t *beacon, size_t size)
{
    (void)user;
    if (udp_sender >= 0)
        (void)sendto(udp_sender, beacon, size, 0, (const struct sockaddr *)&udp, sizeof udp);
    else
        (void)sendto(link_fd, beacon, size, 0, (const struct sockaddr *)&ethernet, sizeof ethernet);
}

static void to_notices(dcp_out_t *out)
{
    add(out->user, out->data, out->at);
    out->at = 0;
}

typedef enum topic { VARIABLES, NEIGHBOURS, PROTOCOL } topic_t;

static bool wants(const connection_t *connection, topic_t topic, uint16_t protocol_id)
{
    const subscription_t *const subscription = &connection->session.subscription;
    size_t i;
    if (connection->fd < 0)
        return false;
    if (topic != PROTOCOL)
        return topic == VARIABLES ? subscription->variables : subscription->neighbours;
    for (i = 0; i < subscription->count; i++)
        if (subscription->prot_ids[i] == protocol_id)
            return true;
    return owner[protocol_id] == connection->session.number + 1;
}

/* Begin a notification for the next client that wants it. */
static bool next_notice(int *number, topic_t topic, uint16_t protocol_id, dcp_out_t *out, char *text, size_t size)
{
    for (; *number < MAX_SESSIONS; *number += 1) {
        if (!wants(&connections[*number], topic, protocol_id))
            continue;
        memset(out, 0, sizeof *out);
        out->data = text;
        out->size = size;
        out->flush = to_notices;
        out->user = &notices[(*number)++];
        return true;
    }
    return false;
}

static dcp_octets_t octets_of(const uint8_t *data, size_t size)
{
    dcp_octets_t octets;
    octets.data = data;
    octets.size = size;
    return octets;
}

static void received(void *user, uint16_t protocol_id, const uint8_t *payload, size_t size, const uint8_t *sender_id)
{
    const dcp_octets_t content = octets_of(payload, size), sender = octets_of(sender_id, NODE_ID_SIZE);
    char text[1024];
    dcp_out_t out;
    int i = 0;
    (void)user;
    while (next_notice(&i, PROTOCOL, protocol_id, &out, text, sizeof text))
        dcp_notify_bp_receive_payload(&out, (int64_t)size, &content, protocol_id, &sender);
}

static void transmitted(void *user, uint16_t protocol_id, int64_t next_beacon)
{
    char text[1024];
    dcp_out_t out;
    int i = 0;
    (void)user;
    while (next_notice(&i, PROTOCOL, protocol_id, &out, text, sizeof text))
        dcp_notify_bp_payload_transmitted(&out, next_beacon, protocol_id);
}

static void variable_changed(void *user, variable_event_t event, const variable_t *variable)
{
    static const char *const names[] = {"created", "updated", "deleted"};
    const dcp_octets_t value = variable->record.upd.value, prod_id = octets_of(variable->prod_id, NODE_ID_SIZE);
    char text[1024];
    dcp_out_t out;
    int i = 0;
    (void)user;
    while (next_notice(&i, VARIABLES, 0, &out, text, sizeof text))
        dcp_notify_ut_variable_changed(&out, names[event], &prod_id, variable->record.upd.seqno,
                                       event != DELETED ? &value : NULL, variable->record.spec.var_id);
}

static void neighbour_seen(void *user, const uint8_t *node_id, bool is_new)
{
    const dcp_octets_t id = octets_of(node_id, NODE_ID_SIZE);
    char text[1024];
    dcp_out_t out;
    int i = 0;
    (void)user;
    while (next_notice(&i, NEIGHBOURS, 0, &out, text, sizeof text))
        dcp_notify_ut_neighbour_seen(&out, is_new, &id);
}

static void neighbour_expired(void *user, const uint8_t *node_id)
{
    const dcp_octets_t id = octets_of(node_id, NODE_ID_SIZE);
    char text[1024];
    dcp_out_t out;
    int i = 0;
    (void)user;
    while (next_notice(&i, NEIGHBOURS, 0, &out, text, sizeof text))
        dcp_notify_ut_neighbour_expired(&out, &id);
}

static const node_events_t events = {send_beacon,      received,       transmitted,
                                     variable_changed, neighbour_seen, neighbour_expired};

/* ---- the control socket ---------------------------------------------------------------------------------------------- */

static void close_connection(connection_t *connection)
{
    size_t i;
    for (i = 0; i <= UINT16_MAX; i++)
        if (owner[i] == connection->session.number + 1)
            owner[i] = 0; /* the registration itself remains [BP-REC-01] */
    (void)close(connection->fd);
    connection->fd = -1;
    free(connection->in.data);
    free(connection->out.data);
    memset(&connection->in, 0, sizeof connection->in);
    memset(&connection->out, 0, sizeof connection->out);
}

static void write_out(connection_t *connection)
{
    while (connection->fd >= 0 && connection->out.size != 0) {
        const ssize_t sent = send(connection->fd, connection->out.data, connection->out.size,
                                  MSG_NOSIGNAL | MSG_DONTWAIT);
        if (sent > 0) {
            consume(&connection->out, (size_t)sent);
        } else {
            if (errno != EAGAIN && errno != EINTR)
                close_connection(connection);
            return;
        }
    }
    if (connection->fd >= 0 && connection->ended)
        close_connection(connection);
}

static void deliver_notices(void)
{
    int i;
    for (i = 0; i < MAX_SESSIONS; i++) {
        connection_t *const connection = &connections[i];
        if (notices[i].size == 0)
            continue;
        if (connection->fd >= 0)
            add(&connection->out, notices[i].data, notices[i].size);
        notices[i].size = 0;
        if (connection->fd >= 0 && connection->out.size > MAX_WAITING)
            close_connection(connection);
        write_out(connection);
    }
}

static void registered(int number, uint16_t protocol_id)
{
    owner[protocol_id] = number + 1;
}

static void to_connection(dcp_out_t *out)
{
    const session_t *const session = out->user;
    add(&connections[session->number].out, out->data, out->at);
    out->at = 0;
}

static void handle(connection_t *connection, char *line, size_t size)
{
    char text[4096];
    dcp_out_t out;
    memset(&out, 0, sizeof out);
    out.data = text;
    out.size = sizeof text;
    out.flush = to_connection;
    out.user = &connection->session;
    if (connection->skipping || size > MAX_LINE)
        dcp_line_too_long(&out);
    else
        dcp_handle_line(&methods, &node, line, size, &out);
    connection->skipping = false;
    deliver_notices();
}

static void read_requests(connection_t *connection)
{
    char data[65536], *end;
    const ssize_t size = recv(connection->fd, data, sizeof data, MSG_DONTWAIT);
    size_t done = 0;
    if (size < 0 && (errno == EAGAIN || errno == EINTR))
        return;
    if (size <= 0) {
        /* The other side may still read the answers to its last requests. */
        if (connection->in.size != 0)
            handle(connection, connection->in.data, connection->in.size);
        connection->ended = true;
        write_out(connection);
        return;
    }
    add(&connection->in, data, (size_t)size);
    while (connection->fd >= 0 && (end = memchr(connection->in.data + done, '\n', connection->in.size - done)) != NULL) {
        char *const line = connection->in.data + done;
        done = (size_t)(end - connection->in.data) + 1u;
        handle(connection, line, (size_t)(end - line));
    }
    if (connection->fd < 0)
        return;
    consume(&connection->in, done);
    if (connection->in.size > MAX_LINE) {
        connection->in.size = 0;
        connection->skipping = true;
    }
    write_out(connection);
}

static void accept_client(void)
{
    const int fd = accept4(listener, NULL, NULL, SOCK_CLOEXEC);
    int i;
    if (fd < 0)
        return;
    for (i = 0; i < MAX_SESSIONS && connections[i].fd >= 0; i++)
        ;
    if (i == MAX_SESSIONS) {
        (void)close(fd);
        return;
    }
    memset(&connections[i], 0, sizeof connections[i]);
    connections[i].fd = fd;
    connections[i].session.number = i;
    connections[i].session.clock = now;
    connections[i].session.registered = registered;
}

static void open_control(const char *path)
{
    struct sockaddr_un address;
    memset(&address, 0, sizeof address);
    address.sun_family = AF_UNIX;
    if (strlen(path) >= sizeof address.sun_path) {
        (void)fprintf(stderr, "%s: the path is too long\n", path);
        exit(1);
    }
    strcpy(address.sun_path, path);
    (void)unlink(path);
    (void)umask(0177);
    listener = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (listener < 0 || bind(listener, (struct sockaddr *)&address, sizeof address) != 0 || listen(listener, 16) != 0)
        fatal(path);
}

/* ---- the link ------------------------------------------------------------------------------------------------------------ */

static void open_ethernet(const char *interface, uint8_t *id)
{
    struct ifreq request;
    const int size = 8 << 20;
    memset(&request, 0, sizeof request);
    strncpy(request.ifr_name, interface, sizeof request.ifr_name - 1u);
    link_fd = socket(AF_PACKET, SOCK_DGRAM | SOCK_CLOEXEC, htons(ETHER_TYPE));
    if (link_fd < 0 || ioctl(link_fd, SIOCGIFHWADDR, &request) != 0)
        fatal(interface);
    memcpy(id, request.ifr_hwaddr.sa_data, NODE_ID_SIZE);
    if (ioctl(link_fd, SIOCGIFINDEX, &request) != 0)
        fatal(interface);
    ethernet.sll_family = AF_PACKET;
    ethernet.sll_protocol = htons(ETHER_TYPE);
    ethernet.sll_ifindex = request.ifr_ifindex;
    ethernet.sll_halen = ETH_ALEN;
    memset(ethernet.sll_addr, 0xFF, ETH_ALEN);
    (void)setsockopt(link_fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    if (bind(link_fd, (struct sockaddr *)&ethernet, sizeof ethernet) != 0)
        fatal(interface);
}

static void open_udp(void)
{
    const int yes = 1, size = 8 << 20;
    struct in_addr loopback;
    struct ip_mreq group;
    socklen_t length = sizeof own_address;
    loopback.s_addr = htonl(INADDR_LOOPBACK);
    udp.sin_family = AF_INET;
    udp.sin_port = htons(UDP_PORT);
    udp.sin_addr.s_addr = inet_addr(UDP_GROUP);
    group.imr_multiaddr = udp.sin_addr;
    group.imr_interface = loopback;
    link_fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    udp_sender = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    memset(&own_address, 0, sizeof own_address);
    own_address.sin_family = AF_INET;
    own_address.sin_addr = loopback;
    (void)setsockopt(link_fd, SOL_SOCKET, SO_RCVBUF, &size, sizeof size);
    if (link_fd < 0 || udp_sender < 0 || setsockopt(link_fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0
        || bind(link_fd, (struct sockaddr *)&udp, sizeof udp) != 0
        || setsockopt(link_fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &group, sizeof group) != 0
        || bind(udp_sender, (struct sockaddr *)&own_address, sizeof own_address) != 0
        || setsockopt(udp_sender, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback) != 0
        || getsockname(udp_sender, (struct sockaddr *)&own_address, &length) != 0)
        fatal("udp");
}

/* Read what has arrived, at most a few frames before beacons and requests have their turn. */
static void read_link(void)
{
    static uint8_t octets[65536];
    int i;
    for (i = 0; i < 64; i++) {
        union {
            struct sockaddr_ll ethernet;
            struct sockaddr_in udp;
        } from;
        socklen_t length = sizeof from;
        const ssize_t size = recvfrom(link_fd, octets, sizeof octets, MSG_DONTWAIT, (struct sockaddr *)&from, &length);
        if (size < 0)
            return;
        if (udp_sender >= 0 ? from.udp.sin_port == own_address.sin_port
                                  && from.udp.sin_addr.s_addr == own_address.sin_addr.s_addr
                            : from.ethernet.sll_pkttype == PACKET_OUTGOING)
            continue;
        node_receive(&node, octets, (size_t)size, now());
    }
}

/* ---- the loop ------------------------------------------------------------------------------------------------------------- */

static void stop(int signal_number)
{
    (void)signal_number;
    stopped = 1;
}

static void run(void)
{
    struct pollfd polled[MAX_SESSIONS + 2];
    while (!stopped) {
        const int64_t left = node_due(&node) - read_clock(CLOCK_MONOTONIC);
        struct timespec wait = {0, 0};
        int i;
        for (i = 0; i < MAX_SESSIONS; i++) {
            polled[i].fd = connections[i].fd;
            polled[i].events = (short)((connections[i].ended ? 0 : POLLIN) | (connections[i].out.size != 0 ? POLLOUT : 0));
            polled[i].revents = 0;
        }
        polled[MAX_SESSIONS].fd = link_fd;
        polled[MAX_SESSIONS + 1].fd = listener;
        polled[MAX_SESSIONS].events = polled[MAX_SESSIONS + 1].events = POLLIN;
        polled[MAX_SESSIONS].revents = polled[MAX_SESSIONS + 1].revents = 0;
        if (left > 0) {
            wait.tv_sec = (time_t)(left / 1000000000);
            wait.tv_nsec = (long)(left % 1000000000);
        }
        if (ppoll(polled, MAX_SESSIONS + 2, &wait, NULL) < 0)
            continue;
        if (polled[MAX_SESSIONS].revents != 0)
            read_link();
        node_poll(&node, now());
        deliver_notices();
        for (i = 0; i < MAX_SESSIONS; i++) {
            if (connections[i].fd < 0 || polled[i].fd != connections[i].fd)
                continue;
            if ((polled[i].revents & POLLOUT) != 0)
                write_out(&connections[i]);
            if (connections[i].fd >= 0 && (polled[i].revents & (POLLIN | POLLHUP | POLLERR)) != 0)
                read_requests(&connections[i]);
        }
        if (polled[MAX_SESSIONS + 1].revents != 0)
            accept_client();
    }
}

static const char usage[] =
    "usage: c-node (-i INTERFACE | -u NODE-ID) [-c SOCKET]\n"
    "  -i INTERFACE  Ethernet, EtherType 0x4953; needs CAP_NET_RAW. The node identifier is the address.\n"
    "  -u NODE-ID    UDP on the loopback interface, group " UDP_GROUP ", port 18771; for example 02:00:00:00:00:01\n"
    "  -c SOCKET     Unix socket for the upper tester\n";

int main(int argc, char **argv)
{
    const char *interface = NULL, *control = NULL, *id_text = NULL;
    uint8_t id[NODE_ID_SIZE];
    int option, i;
    while ((option = getopt(argc, argv, "i:u:c:")) != -1) {
        if (option == 'i')
            interface = optarg;
        else if (option == 'u')
            id_text = optarg;
        else if (option == 'c')
            control = optarg;
        else
            break;
    }
    if (option != -1 || optind != argc || (interface == NULL) == (id_text == NULL)
        || (id_text != NULL && sscanf(id_text, "%2hhx:%2hhx:%2hhx:%2hhx:%2hhx:%2hhx", &id[0], &id[1], &id[2], &id[3],
                                      &id[4], &id[5]) != 6)) {
        (void)fputs(usage, stderr);
        return 2;
    }
    if (interface != NULL)
        open_ethernet(interface, id);
    else
        open_udp();
    for (i = 0; i < MAX_SESSIONS; i++)
        connections[i].fd = -1;
    node_init(&node, id, &events, NULL, now());
    if (control != NULL)
        open_control(control);
    (void)signal(SIGTERM, stop);
    (void)signal(SIGINT, stop);
    run();
    if (control != NULL)
        (void)unlink(control);
    return 0;
}

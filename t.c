#include "shmgen_wait_any.h"
#include "shmgen_publisher.h"
int main(void){shmgen_subscriber*a[1];return (int)shmgen_ready_any(a,0,1);}
